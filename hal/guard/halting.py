"""What the controller does on a trip, wherever the guard runs: halt every axis, end what was on its way, halt again."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from hal.errors import DeviceError
from hal.guard.logic import Trip
from hal.interfaces import Axis
from hal.latch import Latch


async def halt_all(axes: Sequence[Axis], latch: Latch, trip: Trip, deadline_s: float) -> Trip:
    """Each axis has its own deadline to acknowledge. The trip, with every axis that did not."""
    failed = await _halt(axes, deadline_s)
    if ended := latch.end(*(axis.name for axis in axes)):
        failed |= await _halt([axis for axis in axes if axis.name in ended], deadline_s)
    for name, why in failed.items():
        trip = Trip(f"{trip.reason}; {name} did not acknowledge its halt ({why})", trip.force_n)
    return trip


async def _halt(axes: Sequence[Axis], deadline_s: float) -> dict[str, str]:
    failures = await asyncio.gather(*(_halt_one(axis, deadline_s) for axis in axes))
    return {axis.name: why for axis, why in zip(axes, failures, strict=True) if why}


async def _halt_one(axis: Axis, deadline_s: float) -> str:
    try:
        async with asyncio.timeout(deadline_s):
            await axis.halt()
    except (DeviceError, TimeoutError) as error:
        return str(error) or "no answer"
    return ""
