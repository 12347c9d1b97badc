"""Strikes on an axis on the CAN bus, in any moment of a motion: it arrives or says why, and then it stands."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from hal.bus.hub import BusFault, Kind
from hal.codec.cia301 import EMCY, HEARTBEAT, SDO_REPLY, TPDO1, TPDO2
from hal.codec.lawicel import CanFrame
from hal.codec.sdo import LENGTH, NO_OBJECT, RANGE, READ_ONLY
from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, NotConnected
from hal.fake.faults import Fault, FaultBook
from tests.contract.backends import plant_of, quickened
from tests.contract.wire_axis import Wire, beat, wired
from tests.wire.strikes import Lift, Strike, lasting, nothing

SPEED = 50.0
NODE = 3
CABLE = Fault("jack", "gone", phase="struck", duration_s=1.5)
Errors = tuple[type[DeviceError], ...]


@dataclass(frozen=True, slots=True)
class Fate:
    """What a fault does at its moment; it returns what puts it right. `errors` may then be told, or the axis arrives
    where it `may_arrive`; `must_tell` words in one of them."""

    strike: Callable[[Wire, FaultBook, Random], Awaitable[Lift]]
    errors: Errors
    may_arrive: bool = True
    word: str = ""


async def cable_pulled(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """The drive's, for longer than anybody waits for its heartbeat."""
    return lasting(book, CABLE)


async def adapter_gone(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """Unplugged, and plugged in again after a while."""
    await wire.hub.unplug()

    async def plug() -> None:
        await asyncio.sleep(draw.uniform(0.0, 1.0))
        await wire.hub.start()

    return plug


async def bus_off(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """The adapter must be opened anew."""
    wire.hub.bus_off()
    return nothing


def frames_go(kind: Kind) -> Callable[[Wire, FaultBook, Random], Awaitable[Lift]]:
    """A few frames of the drive or of the controller, from that moment on."""

    async def strike(wire: Wire, book: FaultBook, draw: Random) -> Lift:
        share, late_s = draw.choice((0.3, 1.0)), draw.uniform(0.05, 3.0)
        fault = BusFault(kind, lambda frame: draw.random() < share, draw.randint(1, 3), late_s)
        wire.hub.faults.append(fault)

        async def end() -> None:
            wire.hub.faults.clear()
            await asyncio.sleep(late_s if kind == "late" else 0.0)

        return end

    return strike


async def wrong_ids(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """Frames of another node, and a reply that nobody has asked for."""
    send, end = wire.hub.attach(lambda frame: None)
    for _ in range(draw.randint(1, 20)):
        other = draw.choice([number for number in range(1, 127) if number != NODE])
        send(CanFrame(draw.choice((SDO_REPLY, TPDO1, TPDO2, HEARTBEAT, EMCY)) + other, draw.randbytes(8)))
        send(CanFrame(SDO_REPLY + NODE, b"\x43\x63\x60\x00" + draw.randbytes(4)))
    end()
    return nothing


async def aborts(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """SDO abort codes in the place of answers."""
    wire.node.abort_next += draw.choices((LENGTH, NO_OBJECT, RANGE, READ_ONLY), k=draw.randint(1, 3))

    async def end() -> None:
        wire.node.abort_next.clear()

    return end


async def emergency(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """The drive trips: over-current, over-voltage, over-temperature, following error."""
    wire.node.emergency(draw.choice((0x2310, 0x3210, 0x4310, 0x8611)))
    return nothing


async def drive_silent(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """The drive's heartbeat is not heard."""
    wire.node.muted = True

    async def end() -> None:
        wire.node.muted = False

    return end


async def controller_silent(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """The controller's heartbeat is not heard by the drive."""
    wire.beats.cancel()
    await asyncio.wait({wire.beats})

    async def again() -> None:
        wire.beats = asyncio.create_task(beat(wire.bus), name="beats")

    return again


async def restarted(wire: Wire, book: FaultBook, draw: Random) -> Lift:
    """The drive's supply fails for a moment."""
    wire.node.restart()
    return lambda: asyncio.sleep(1.0)


LOST = (NotConnected, DeviceTimeout, DeviceFault)
"""Which of them depends on what was under way."""
FATES = {
    "cable pulled and plugged back": Fate(cable_pulled, LOST, may_arrive=False),
    "adapter gone": Fate(adapter_gone, LOST, may_arrive=False),
    "bus off": Fate(bus_off, LOST, may_arrive=False),
    "half frames": Fate(frames_go("half"), LOST),
    "lost frames": Fate(frames_go("lost"), LOST),
    "late reply": Fate(frames_go("late"), LOST),
    "duplicate": Fate(frames_go("twice"), ()),
    "wrong id": Fate(wrong_ids, ()),
    "exception codes": Fate(aborts, (DeviceRefused,), word="0x"),
    "EMCY": Fate(emergency, (DeviceFault,), may_arrive=False),
    "lost heartbeat of the drive": Fate(drive_silent, (NotConnected,), may_arrive=False, word="heartbeat"),
    "lost heartbeat of the controller": Fate(controller_silent, (DeviceFault,), may_arrive=False, word="heartbeat"),
    "drive restarted": Fate(restarted, (DeviceFault, NotConnected), may_arrive=False),
}


def struck(fault: str) -> Strike:
    """One motion, one moment."""
    fate = FATES[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{fault} {seed}")

        async def main() -> None:
            book = FaultBook([CABLE])
            async with wired("jack", plant_of("ideal"), book) as wire:
                await wire.axis.connect()
                await wire.axis.home()
                await _struck(wire, book, fate, draw)

        quickened(main(), SPEED, None)

    return strike


async def _struck(wire: Wire, book: FaultBook, fate: Fate, draw: Random) -> None:
    target = draw.uniform(60.0, 300.0)
    move = asyncio.create_task(wire.axis.move_to(target, speed=draw.uniform(10.0, 20.0)))
    await asyncio.sleep(draw.choice((draw.uniform(0.0, 0.02), draw.uniform(0.0, 0.3), draw.uniform(0.0, 2.0))))
    lift = await fate.strike(wire, book, draw)
    try:
        state = await move
    except DeviceError as error:
        assert isinstance(error, fate.errors), f"{error!r} in the place of {fate.errors}"
        assert fate.word in str(error), f"{error!r} says nothing of {fate.word!r}"
        await lift()
        await _stands(wire)
    else:
        assert fate.may_arrive, f"arrived at {state.position:.3f}"
        assert abs(state.position - target) < 0.01, f"{state.position:.3f} reached, {target:.3f} meant"
        await lift()
    await _well(wire, draw)


async def _stands(wire: Wire) -> None:
    """It stands within what its own watchdogs need, and nothing moves it before it is re-armed."""
    motion, loop = wire.node.drive._motion, asyncio.get_running_loop()
    await asyncio.sleep(1.0)
    assert not motion.moving(loop.time()), "it still moves"
    here = motion.position(loop.time())
    for _ in range(100):
        with suppress(DeviceError):
            if (await wire.axis.safe()).safe:
                break
        await asyncio.sleep(0.1)
    else:
        raise AssertionError("it does not come back")
    await asyncio.sleep(1.0)
    assert motion.position(loop.time()) == here, "it was moved"


async def _well(wire: Wire, draw: Random) -> None:
    """Re-armed, and homed where it lost its reference, it goes where it is told."""
    await wire.axis.rearm()
    if not (await wire.axis.read()).homed:
        await wire.axis.home()
    target = draw.uniform(20.0, 50.0)
    assert abs((await wire.axis.move_to(target, speed=40.0)).position - target) < 0.01, "it does not arrive"


STRIKES = {fault: struck(fault) for fault in FATES}
