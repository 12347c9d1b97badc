"""The guns' feed under a watch on both contact forces: it stops the moment a socket meets more than it may."""

from __future__ import annotations

import asyncio
import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellctl.ports import RunContext, RunHeld
from cellctl.steps.motion import move
from cellctl.steps.together import together
from hal.errors import Interrupted
from hal.interfaces import ForceSensor

Name = Literal["a", "b"]
NAMES: tuple[Name, ...] = ("a", "b")
LOOK = 5
"""Samples of contact force that make one look."""
WATCH_S = 1.0
"""The watch is renewed after this; it acts on the first sample that is too high."""


async def feed_watched(run: RunContext, position_mm: float, *, limit_n: float) -> tuple[Name, ...]:
    """Feed slowly to `position_mm`. Returns the guns that met more than `limit_n` on the way; the feed then stands.

    Raises RunHeld where a contact force is no number or stands still.
    """
    speed = run.recipe.tighten.engage.feed_speed_mm_s
    motion = asyncio.ensure_future(move(run, "gun_feed", position_mm, speed=speed))
    watches = {name: asyncio.ensure_future(_until_above(run, name, limit_n)) for name in NAMES}
    try:
        await asyncio.wait({motion, *watches.values()}, return_when=asyncio.FIRST_COMPLETED)
        met = tuple(name for name, watch in watches.items() if watch.done() and watch.result() > limit_n)
        if met and not motion.done():
            await run.ledger.act("gun_feed", "halt", {}, lambda key: run.devices.gun_feed.halt())
        try:
            await motion
        except Interrupted:
            if not met:
                raise
            await run.ledger.act("gun_feed", "rearm", {}, lambda key: run.devices.gun_feed.rearm())
        return met
    finally:
        for task in (motion, *watches.values()):
            task.cancel()
        await asyncio.gather(motion, *watches.values(), return_exceptions=True)


async def forces_n(run: RunContext) -> dict[Name, float]:
    """Mean contact force of each gun over one look. Raises RunHeld where one is no number or stands still."""
    a, b = await together(run.devices.gun_force_a.block(LOOK), run.devices.gun_force_b.block(LOOK))
    return {"a": _mean("a", a.samples_n), "b": _mean("b", b.samples_n)}


async def _until_above(run: RunContext, name: Name, limit_n: float) -> float:
    """The first contact force above `limit_n`. Raises RunHeld where the signal is not alive."""
    sensor: ForceSensor = run.devices.gun_force_a if name == "a" else run.devices.gun_force_b
    count = max(LOOK, round(WATCH_S * sensor.rate_hz))
    while True:
        samples_n = (await sensor.block(count, high_n=limit_n)).samples_n
        if not samples_n[-1] <= limit_n:
            return _mean(name, samples_n[-1:])
        _mean(name, samples_n)


def _mean(name: Name, samples_n: NDArray[np.float64]) -> float:
    mean = float(np.mean(samples_n))
    if not math.isfinite(mean):
        raise _implausible(name, f"reads {mean}")
    if len(samples_n) >= LOOK and float(np.ptp(samples_n)) == 0.0:
        raise _implausible(name, f"stands still at {mean:.1f} N, which no live signal does")
    return mean


def _implausible(name: Name, what: str) -> RunHeld:
    return RunHeld("gun_force_implausible", f"the contact force of gun {name} {what}")
