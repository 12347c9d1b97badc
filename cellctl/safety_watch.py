"""Aborts the cell when a safety input opens while it works. The hard-wired circuit has acted by then."""

from __future__ import annotations

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
    """For ever: wait until the cell works, then until a safety input opens; `until_unsafe` gives the reason."""
    while True:
        await controller.until(*WORKING)
        reason = await until_unsafe()
        if controller.state in WORKING and Command.ABORT in controller.allowed():
            controller.request(Command.ABORT, reason)
