"""Aborts the cell when a safety input opens while it works. The hard-wired circuit has acted by then."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from cellctl.controller import Controller
from cellctl.states import Command, State

WORKING = (
    State.STARTING,
    State.EXECUTE,
    State.HOLDING,
    State.HELD,
    State.UNHOLDING,
    State.SUSPENDING,
    State.SUSPENDED,
    State.UNSUSPENDING,
    State.COMPLETING,
)


async def watch_safety(controller: Controller, until_unsafe: Callable[[], Awaitable[str]]) -> None:
    """For ever: while the cell works, wait until a safety input opens; `until_unsafe` gives the reason."""
    at_rest = [state for state in State if state not in WORKING]
    while True:
        await controller.until(*WORKING)
        unsafe = asyncio.ensure_future(until_unsafe())
        rest = asyncio.ensure_future(controller.until(*at_rest))
        try:
            await asyncio.wait({unsafe, rest}, return_when=asyncio.FIRST_COMPLETED)
            if unsafe.done() and controller.state in WORKING:
                controller.request(Command.ABORT, unsafe.result())
        finally:
            for task in (unsafe, rest):
                task.cancel()
            await asyncio.wait({unsafe, rest})
