"""Faults on each bus, struck once at a moment that a seed draws: what must come of it, and that all is well again.

A strike is a function of a seed that raises where something is wrong: an error that is not the true one, something done
that nobody asked for or done twice, or a device that does not come back.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from hal.fake.faults import Fault, FaultBook

Strike = Callable[[int], None]
Lift = Callable[[], Awaitable[None]]
"""What ends a fault."""
ESTOP = Fault("safety", "estop", phase="stopped", duration_s=6.0)


class Booked(Protocol):
    """Where a fault of the book strikes."""

    @property
    def book(self) -> FaultBook: ...


async def nothing() -> None:
    """There is nothing to be put right."""


def lasting(book: FaultBook, fault: Fault) -> Lift:
    """A fault of the book from here on; lifted, it has come to its end."""
    loop = asyncio.get_running_loop()
    book.enter_phase(fault.phase or "", loop.time())
    until_s = loop.time() + fault.duration_s
    return lambda: asyncio.sleep(until_s - loop.time())


def entered(fault: Fault) -> Callable[[Booked], Awaitable[Lift]]:
    """The strike with that fault of the book."""

    async def strike(at: Booked) -> Lift:
        return lasting(at.book, fault)

    return strike


def power_cut(linked: Callable[[Any], Awaitable[None]]) -> Callable[[Any], Awaitable[Lift]]:
    """The hard-wired circuit takes the power of a gun, which is re-armed once `linked` has seen it back."""

    async def strike(at: Any) -> Lift:
        at.book.enter_phase(ESTOP.phase or "", asyncio.get_running_loop().time())

        async def end() -> None:
            await asyncio.sleep(ESTOP.duration_s)
            await linked(at.gun)
            await at.gun.rearm()

        return end

    return strike
