"""One axis moved by hand, under the rules that bind the controller: interlocks, safety mirror, limits, force watch.

The shaft rises only under the armed force guard. In reach of the studs (above `free_mm` of the cell's envelope) the
trip leaves room for the overshoot at the asked speed; below, nothing is there to be met, and the trip is coarse. The
guns' feed goes out under a watch on both contact forces. Motion away from trouble (jack down, guns back) needs least.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cellctl.checks.docking import trip_n, usable_trip_n
from cellctl.commissioning.bench import connected
from hal.cell import Cell, CellFailure
from hal.config import CellConfig
from hal.errors import CellError, DeviceError, DeviceRefused
from hal.interfaces import AxisState, ForceSensor, GuardLimits
from hal.permits import AXES, NEEDED, AxisName
from hal.permitted import PermittedAxis

SLOW_SHARE = 0.1
"""Of an axis' largest speed, where no speed is asked for."""
CONTACT_MM_S = 0.2
"""Of the jack in reach of the studs, likewise."""
FEED_MM_S = 2.0
"""Of the guns' feed, likewise."""
FREE_TRIP_N = 50.0
"""Net force that stops the jack where nothing is there to be met."""
LIMIT_N = {"jack": 10.0, "gun_feed": 25.0}
"""Contact force that must not be exceeded, of a stud and of a socket. A lower one may be asked for."""
TARE_S = 0.5
TELL_S = 0.5
"""Between two looks at a moving axis."""
LOOK = 5
"""Samples of contact force that tell a live signal from one that stands still."""
WATCHES = {"jack": ("jack_force",), "gun_feed": ("gun_force_a", "gun_force_b")}


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked for: a position, a distance from here, or the reference. Units of the axis, newton."""

    axis: AxisName
    to: float | None = None
    by: float | None = None
    speed: float | None = None
    limit_n: float | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """What will be done. `trip_n` is what stops the motion, None where no force is watched."""

    axis: AxisName
    unit: str
    start: AxisState
    target: float | Literal["home"]
    speed: float
    trip_n: float | None

    def __str__(self) -> str:
        if self.target == "home":
            return f"{self.axis}: find its reference, from {self.start.position:.3f} {self.unit}"
        force = "" if self.trip_n is None else f", stops at {self.trip_n:.1f} N of contact force"
        way = f"{self.start.position:.3f} to {self.target:.3f} {self.unit}"
        return f"{self.axis}: from {way} at {self.speed:g} {self.unit}/s{force}"


@dataclass(frozen=True, slots=True)
class Jogged:
    """How it ended: `end` and, where the axis did not arrive, why. `rest` is the drive's own word at the end."""

    end: Literal["arrived", "stopped"]
    state: AxisState
    rest: str
    reason: str = ""


async def reach(cell: Cell, axis: AxisName) -> None:
    """Connect the axis, what its rules look at, and its force sensors; a trip of the guard from before is cleared.

    The other axes are connected where they can be: a trip of the guard halts them too. Raises CellFailure with all
    that failed, and what the guard has against being cleared.
    """
    needed = {axis, *NEEDED[axis], *WATCHES.get(axis, ())}
    failures = await connected(getattr(cell, name) for name in sorted(needed.union(AXES)))
    if wrong := {name: error for name, error in failures.items() if name in needed}:
        raise CellFailure("connect", wrong, len(needed))
    await cell.guard.rearm()


async def plan_of(cell: Cell, config: CellConfig, wish: Wish) -> Plan:
    """Raises DeviceRefused, naming the limit, for what the axis may not be asked."""
    axis = _axis(cell, wish.axis)
    start, limits = await axis.read(), axis.limits
    target: float | Literal["home"] = "home"
    if wish.to is not None:
        target = wish.to
    elif wish.by is not None:
        target = start.position + wish.by
    if target != "home":
        if not start.homed:
            raise DeviceRefused("is not homed: find its reference first (--home)", device=axis.name)
        _within(axis.name, "position", target, limits.low, limits.high, axis.unit)
    onward = target != "home" and target > start.position
    in_reach = wish.axis == "jack" and target != "home" and target > config.envelope.free_mm
    slow = _slow(wish.axis, limits.max_speed, in_reach=in_reach and onward)
    speed = slow if wish.speed is None else wish.speed
    _within(axis.name, "speed", speed, 0.0, limits.max_speed, f"{axis.unit}/s")
    trip = None
    if onward and wish.axis in WATCHES:
        limit_n = LIMIT_N[wish.axis] if wish.limit_n is None else wish.limit_n
        _within(axis.name, "force limit", limit_n, 0.0, LIMIT_N[wish.axis], "N")
        trip = limit_n if wish.axis == "gun_feed" else _jack_trip_n(config, limit_n, speed) if in_reach else FREE_TRIP_N
    return Plan(wish.axis, axis.unit, start, target, speed, trip)


@contextlib.asynccontextmanager
async def guarded(cell: Cell, config: CellConfig, plan: Plan) -> AsyncIterator[None]:
    """The force guard is armed inside where the shaft is to rise; what stands on the sensor now is the tare.

    Raises GuardTripped where the sensor is of no use.
    """
    if plan.axis != "jack" or plan.trip_n is None:
        yield
        return
    tare_n = float(np.mean((await cell.guard.window(TARE_S)).samples_n))
    delays = config.guard
    pull_n = -max(plan.trip_n, FREE_TRIP_N)
    await cell.guard.arm(GuardLimits("jog", tare_n, plan.trip_n, pull_n, delays.stale_ms, delays.contact_block))
    try:
        yield
    finally:
        await cell.guard.disarm()


async def refuse(cell: Cell, plan: Plan) -> None:
    """Ask the motion rules before anybody is asked to agree. Raises SafetyOpen, GuardTripped, DeviceRefused."""
    if refused := await _axis(cell, plan.axis).refusal(plan.target):
        raise refused


async def carry_out(
    cell: Cell, plan: Plan, halt: asyncio.Event, told: Callable[[AxisState], None] = lambda state: None
) -> Jogged:
    """Enable the drive where it stands and move it; `halt` stops it. `told` hears where it is on the way.

    It ends at rest, read back, with the reason where it did not arrive. Raises CellError where the drive cannot be
    enabled or is not proven at rest.
    """
    axis = _axis(cell, plan.axis)
    await axis.rearm()
    target, speed = plan.target, plan.speed
    motion = asyncio.ensure_future(axis.home() if target == "home" else axis.move_to(target, speed=speed))
    stops = [asyncio.ensure_future(_asked(halt))]
    if plan.axis == "gun_feed" and plan.trip_n is not None:
        stops += [asyncio.ensure_future(_met(getattr(cell, name), plan.trip_n)) for name in WATCHES["gun_feed"]]
    try:
        reason = await _until_done(axis, motion, stops, told)
    finally:
        for task in (motion, *stops):
            task.cancel()
        await asyncio.gather(motion, *stops, return_exceptions=True)
    guard = cell.guard.state()
    return await _at_rest(axis, guard.reason if guard.tripped else reason)


async def _at_rest(axis: PermittedAxis, reason: str) -> Jogged:
    """Halt, acknowledged, and read back. Raises DeviceError where rest is not proven."""
    try:
        await axis.halt()
        state, rest = await axis.read(), (await axis.safe()).detail
    except CellError as error:
        first = f"{reason}; " if reason else ""
        raise DeviceError(f"{first}not proven at rest: {error.reason}", device=axis.name) from error
    return Jogged("stopped" if reason else "arrived", state, rest, reason)


async def _until_done(
    axis: PermittedAxis,
    motion: asyncio.Future[Any],
    stops: Iterable[asyncio.Future[Any]],
    told: Callable[[AxisState], None],
) -> str:
    """Returns why the axis did not arrive, or an empty string."""
    while not motion.done():
        await asyncio.wait([motion, *stops], timeout=TELL_S, return_when=asyncio.FIRST_COMPLETED)
        if not motion.done() and (stopped := next((stop for stop in stops if stop.done()), None)):
            with contextlib.suppress(CellError):  # proven, or told, when it should be at rest
                await axis.halt()
            return str(stopped.result())
        if not motion.done():
            with contextlib.suppress(CellError):  # the motion itself says what is wrong
                told(await axis.read())
    error = motion.exception()
    if error is not None and not isinstance(error, CellError):
        raise error
    return "" if error is None else str(error)


async def _asked(halt: asyncio.Event) -> str:
    await halt.wait()
    return "halted on demand"


async def _met(sensor: ForceSensor, limit_n: float) -> str:
    """Returns what was met beyond `limit_n`, or why the sensor is of no use any more."""
    while True:
        try:
            samples_n = (await sensor.block(max(LOOK, round(sensor.rate_hz)), high_n=limit_n)).samples_n
        except CellError as error:
            return str(error)
        last_n = float(samples_n[-1])
        if last_n > limit_n:
            return f"{sensor.name}: {last_n:.1f} N of contact force (limit {limit_n:g} N)"
        if math.isnan(last_n) or (len(samples_n) >= LOOK and float(np.ptp(samples_n)) == 0.0):
            return f"{sensor.name}: stands still at {last_n:.1f} N, which no live signal does"


def _axis(cell: Cell, name: AxisName) -> PermittedAxis:
    axis = getattr(cell, name)
    assert isinstance(axis, PermittedAxis), "every axis of a cell is behind its rules"
    return axis


def _slow(axis: AxisName, largest: float, *, in_reach: bool) -> float:
    speed = CONTACT_MM_S if in_reach else FEED_MM_S if axis == "gun_feed" else SLOW_SHARE * largest
    return min(speed, largest)


def _within(device: str, what: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high or (what != "position" and value == 0.0):
        raise DeviceRefused(f"{what} {value:g} {unit} is refused (limit {low:g} to {high:g} {unit})", device=device)


def _jack_trip_n(config: CellConfig, limit_n: float, speed_mm_s: float) -> float:
    """Raises DeviceRefused for a speed that leaves no trip below `limit_n`."""
    cell, delays = config.cell, config.guard
    trip = trip_n(
        limit_n,
        speed_mm_s,
        delays,
        stiffness_n_per_mm=cell.jack_stiffness_n_per_mm,
        mass_kg=cell.moving_mass_kg,
        deceleration_mm_s2=config.devices.jack.max_acceleration,
    )
    usable = usable_trip_n(limit_n, delays)
    if trip < usable:
        text = f"{speed_mm_s:g} mm/s leaves a trip force of {trip:.2f} N (limit >= {usable:.2f} N): go slower"
        raise DeviceRefused(f"above {config.envelope.free_mm:g} mm the studs are in reach: {text}", device="jack")
    return trip
