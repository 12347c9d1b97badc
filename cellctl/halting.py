"""Halting the whole cell with a deadline that holds even where a device or the cell itself hangs; what it answers."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

from cellctl.session import SafeCell

MARGIN_S = 0.5
"""What `make_safe` may take beyond its own deadline before it counts as broken."""


@dataclass(frozen=True, slots=True)
class Proof:
    """What came of a halt: devices not proven safe, with the reason; `code` is empty where all are."""

    code: str = ""
    text: str = ""
    unsafe: dict[str, str] = field(default_factory=dict)


async def prove_safe(
    cell: SafeCell, deadline_s: float, spawn: Callable[[Coroutine[Any, Any, Any]], asyncio.Task[Any]]
) -> Proof:
    """Halt everything in a task of its own and say what was read back. Never raises, never waits for ever."""
    halt = spawn(cell.make_safe(deadline_s))
    await asyncio.wait({halt}, timeout=deadline_s + MARGIN_S)
    if not halt.done():
        halt.cancel()
        return Proof("make_safe_late", f"not proven safe after {deadline_s + MARGIN_S:g} s")
    if halt.cancelled():
        return Proof("make_safe_failed", "making the cell safe was cancelled")
    error = halt.exception()
    if error is not None:
        return Proof("make_safe_failed", f"making the cell safe failed: {error}")
    report = halt.result()
    unsafe = dict(report.unsafe)
    if report.safe:
        return Proof(unsafe=unsafe)
    names = ", ".join(f"{name} ({detail})" for name, detail in unsafe.items())
    return Proof("not_safe", f"not proven safe: {names}", unsafe)


async def answer_of(ask: Callable[[], Awaitable[str]] | None) -> str:
    """The reason that `ask` gives or raises; empty where there is nothing to ask."""
    try:
        return await ask() if ask is not None else ""
    except Exception as error:
        return str(error)
