"""A bus recorded into a file, beside whoever works on it or while its devices are asked how they are."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cellctl.commissioning.bench import opened
from cellctl.commissioning.survey import survey
from hal.capture import CaptureFile, Header
from hal.config import CellConfig
from hal.tap import Bus, Tap, tapped

ASK_S = 1.0
"""Between two rounds of questions."""


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be recorded: `listen` is where a relay waits, `ask` whether the devices are asked from here, and
    `seconds` how long, None until it is ended."""

    bus: Bus
    file: Path
    listen: str = ""
    ask: bool = False
    seconds: float | None = None


async def capture(
    config: CellConfig, recipe: Path, order: Order, ended: asyncio.Event, ready: Callable[[Tap], None]
) -> dict[str, int]:
    """Bytes recorded in each direction; `ready` hears when a controller may come. Raises CellError, OSError."""
    bus = order.bus
    started = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    header = Header(config.cell.name, bus.name, bus.kind, bus.devices, started)
    with CaptureFile(order.file, header) as file:
        async with tapped(config, bus, file.put, order.listen) as tap:
            ready(tap)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(order.seconds):
                    if order.ask:
                        await _ask(tap.config, recipe, bus, ended)
                    await ended.wait()
        return file.counts


async def _ask(config: CellConfig, recipe: Path, bus: Bus, ended: asyncio.Event) -> None:
    async with opened(config, recipe) as cell:
        while not ended.is_set():
            await survey(cell, config, bus.devices)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(ASK_S):
                    await ended.wait()
