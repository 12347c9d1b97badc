"""Strikes on the guard, its links and the bus behind it, while the jack moves: it trips or the axis says why, the drive
stands, and nothing enables it before the cell re-arms."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from random import Random
from typing import Any, cast

from hal.codec.cia402 import State
from hal.errors import CellError, DeviceError, GuardTripped, NotConnected
from hal.fake.faults import FaultBook
from hal.guard.heartbeat import Heartbeat
from tests.contract.wire_axis import Wire
from tests.wire.guard_stand import LIMITS, GuardStand, on_stand
from tests.wire.strikes import Lift, Strike, axis, nothing


@dataclass(frozen=True, slots=True)
class Fate:
    """`trips`: the guard must, or must not (None: it may). `word`: of what it says, or of what the axis says."""

    strike: Callable[[GuardStand, Random], Awaitable[Lift]]
    trips: bool | None
    word: str = ""
    may_arrive: bool = False


def on_bus(
    of_axis: Callable[[Wire, FaultBook, Random], Awaitable[axis.Lift]],
) -> Callable[[GuardStand, Random], Awaitable[Lift]]:
    """What strikes an axis on a bus of its own, behind the guard."""

    @dataclass
    class Behind:
        """As much of `Wire` as the strikes on the bus need."""

        hub: Any
        node: Any

    async def strike(stand: GuardStand, draw: Random) -> Lift:
        return await of_axis(cast(Wire, Behind(stand.guard.hub, stand.node)), FaultBook(), draw)

    return strike


async def cable_pulled(stand: GuardStand, draw: Random) -> Lift:
    """The force sensor's."""
    stand.amplifier.unplug()

    async def plug() -> None:
        await asyncio.sleep(draw.uniform(0.0, 1.0))
        stand.amplifier.plug()
        await asyncio.sleep(1.0)

    return plug


async def lines_spoilt(stand: GuardStand, draw: Random) -> Lift:
    """Force lines are lost, broken or cut: samples are missing."""
    setattr(stand.amplifier.wire, draw.choice(("drop", "corrupt", "half")), draw.randint(1, 5))
    return nothing


async def lines_twice(stand: GuardStand, draw: Random) -> Lift:
    """Force lines come twice."""
    stand.amplifier.wire.repeat = draw.randint(1, 50)
    return nothing


async def lines_frozen(stand: GuardStand, draw: Random) -> Lift:
    """The same force line again and again."""
    stand.amplifier.wire.frozen = True

    async def end() -> None:
        stand.amplifier.wire.frozen = False
        await asyncio.sleep(1.0)

    return end


async def controller_silent(stand: GuardStand, draw: Random) -> Lift:
    """The guard hears no beats."""
    await stand.beats.close()

    async def again() -> None:
        stand.beats = stand.guard.beats = Heartbeat(stand.guard.link.beat, lambda: True, 0.02)
        stand.beats.start()

    return again


async def hung_up(stand: GuardStand, draw: Random) -> Lift:
    """The connection between controller and guard ends."""
    controller = stand.guard.process.server.controller
    assert controller is not None
    controller.abort()
    return lambda: asyncio.sleep(1.0)


async def guard_restarted(stand: GuardStand, draw: Random) -> Lift:
    """The guard ends, and another comes."""
    await stand.guard.process.close()

    async def another() -> None:
        await asyncio.sleep(draw.uniform(0.0, 1.0))
        await stand.restart_guard()
        await asyncio.sleep(1.0)

    return another


FATES = {
    "cable pulled and plugged back": Fate(cable_pulled, trips=True, word="insert: "),
    "adapter gone": Fate(on_bus(axis.adapter_gone), trips=True, word="heartbeat"),
    "bus off": Fate(on_bus(axis.bus_off), trips=None),
    "half frames": Fate(on_bus(axis.frames_go("half")), trips=None, may_arrive=True),
    "lost frames": Fate(on_bus(axis.frames_go("lost")), trips=None, may_arrive=True),
    "late reply": Fate(on_bus(axis.frames_go("late")), trips=None, may_arrive=True),
    "duplicate": Fate(on_bus(axis.frames_go("twice")), trips=False, may_arrive=True),
    "wrong id": Fate(on_bus(axis.wrong_ids), trips=False, may_arrive=True),
    "exception codes": Fate(on_bus(axis.aborts), trips=None, may_arrive=True),
    "EMCY": Fate(on_bus(axis.emergency), trips=None),
    "lost heartbeat of the drive": Fate(on_bus(axis.drive_silent), trips=None),
    "lost heartbeat of the controller": Fate(controller_silent, trips=True, word="not heard"),
    "force lines lost or broken": Fate(lines_spoilt, trips=True, word="expected"),
    "force lines twice": Fate(lines_twice, trips=False, may_arrive=True),
    "the same force line again and again": Fate(lines_frozen, trips=True, word="silent"),
    "controller hangs up": Fate(hung_up, trips=True, word="lost"),
    "guard restarted": Fate(guard_restarted, trips=True, word="shut down"),
    "drive restarted": Fate(on_bus(axis.restarted), trips=None),
}


def struck(fault: str) -> Strike:
    """One guarded motion, one moment."""
    fate = FATES[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{fault} {seed}")

        async def case(stand: GuardStand) -> None:
            await _struck(stand, fate, draw)

        on_stand(case)

    return strike


async def _struck(stand: GuardStand, fate: Fate, draw: Random) -> None:
    await stand.client.arm(LIMITS)
    target = draw.uniform(12.0, 20.0)
    move = asyncio.create_task(stand.axis.move_to(target, speed=10.0))
    await asyncio.sleep(draw.choice((draw.uniform(0.0, 0.05), draw.uniform(0.0, 0.8))))
    lift = await fate.strike(stand, draw)
    error: DeviceError | GuardTripped | None = None
    try:
        state = await move
    except (DeviceError, GuardTripped) as told:
        error = told
    else:
        assert fate.may_arrive, f"arrived at {state.position:.3f}"
        assert abs(state.position - target) < 0.01, f"{state.position:.3f} reached, {target:.3f} meant"
    await asyncio.sleep(0.5)
    guard = stand.client.state()
    if fate.trips is not None and (error is not None or not fate.may_arrive or not fate.trips):
        assert guard.tripped == fate.trips, f"tripped {guard.tripped} ({guard.reason}), {error!r}"
    assert fate.word in guard.reason, f"{guard.reason!r} says nothing of {fate.word!r}"
    if error is not None or guard.tripped:
        await _stands(stand, tripped=guard.tripped)
    await lift()
    await _well(stand, draw)


async def _stands(stand: GuardStand, *, tripped: bool) -> None:
    """Nothing moves it, and where the guard tripped nothing enables it."""
    motion, loop = stand.node.drive._motion, asyncio.get_running_loop()
    await asyncio.sleep(0.5)
    assert not motion.moving(loop.time()), "it still moves"
    here = motion.position(loop.time())
    if tripped:
        with contextlib.suppress(CellError):
            await stand.axis.rearm()
        assert stand.node.drive.state is not State.OPERATION_ENABLED, "enabled while the trip is latched"
    assert motion.position(loop.time()) == here, "it was moved"


async def _well(stand: GuardStand, draw: Random) -> None:
    """Re-armed as the cell does, and homed where it lost its reference, it goes where it is told, under the guard."""
    await _again(stand.rearm)
    if not (await stand.axis.read()).homed:
        await stand.axis.home()
    target = draw.uniform(2.0, 8.0)
    await stand.client.arm(LIMITS)
    assert abs((await stand.axis.move_to(target, speed=20.0)).position - target) < 0.01, "it does not arrive"
    state = await stand.client.disarm()
    assert not state.tripped, state.reason


async def _again(work: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Until adapter and link are back."""
    for _ in range(50):
        with contextlib.suppress(NotConnected, DeviceError, GuardTripped):
            await work()
            return
        await asyncio.sleep(0.2)
    await work()


STRIKES = {fault: struck(fault) for fault in FATES}
