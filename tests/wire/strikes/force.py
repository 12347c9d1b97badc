"""Strikes on the line of a force amplifier, in any moment of its stream: no wrong sample, no old one, none twice."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from random import Random

from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, NotConnected
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.force import ForceAmplifier
from hal.real.force import SerialForceSensor
from tests.contract.backends import plant_of, quickened
from tests.contract.wire_force import wired
from tests.wire.strikes import Lift, Strike, entered, nothing

NAME = "gun_force_a"
SPEED = 2.0
OLD_S = 0.2
"""Loop time that a busy machine's kernel may hold a line back at this speed."""
HUNG = Fault(NAME, "hung", phase="hung", duration_s=1.5)
LATE = Fault(NAME, "late", phase="late", value=0.4, duration_s=1.5)
GONE = Fault(NAME, "gone", phase="gone", duration_s=1.5)


@dataclass(frozen=True, slots=True)
class At:
    """Where a fault strikes."""

    amplifier: ForceAmplifier
    sensor: SerialForceSensor
    book: FaultBook
    draw: Random


@dataclass(frozen=True, slots=True)
class Fate:
    """`errors` may be told, of which one must be where it `must` be noticed by the reader; `gap`: samples are missing
    afterwards; `old`: so late may they be."""

    strike: Callable[[At], Awaitable[Lift]]
    errors: tuple[type[DeviceError], ...] = ()
    must: bool = False
    gap: bool = False
    old_s: float = OLD_S


async def pulled(at: At) -> Lift:
    """The cable between adapter and machine: the port is gone."""
    at.amplifier.unplug()

    async def plug() -> None:
        await asyncio.sleep(at.draw.uniform(0.0, 1.0))
        at.amplifier.plug()

    return plug


def lines(kind: str) -> Callable[[At], Awaitable[Lift]]:
    """A few of them."""

    async def strike(at: At) -> Lift:
        setattr(at.amplifier.wire, kind, at.draw.randint(1, 5))
        return nothing

    return strike


def state(kind: str) -> Callable[[At], Awaitable[Lift]]:
    """For as long as it takes to be noticed."""

    async def strike(at: At) -> Lift:
        setattr(at.amplifier.wire, kind, True)

        async def end() -> None:
            setattr(at.amplifier.wire, kind, False)

        return end

    return strike


async def answers_late(at: At) -> Lift:
    """An answer comes with the next one: nobody takes it for that."""
    at.amplifier.wire.late_answers = 1
    try:
        await at.sensor.halt()
    except DeviceTimeout:
        return nothing
    raise AssertionError("an answer that has not come was taken")


async def another(at: At) -> Lift:
    """Another amplifier is plugged in, and then the right one again."""
    serial, at.amplifier.serial = at.amplifier.serial, "another"
    at.amplifier.unplug()
    await asyncio.sleep(0.05)
    at.amplifier.plug()

    async def right() -> None:
        at.amplifier.serial = serial

    return right


async def restarted(at: At) -> Lift:
    """Its supply fails for a moment: it waits to be started."""
    await at.amplifier.power_off()
    return nothing


FATES = {
    "cable pulled and plugged back": Fate(pulled, (NotConnected,), must=True, gap=True),
    "adapter gone": Fate(entered(GONE), (NotConnected,), must=True, gap=True),
    "half frames": Fate(lines("half"), gap=True),
    "lost lines": Fate(lines("drop"), gap=True),
    "wrong checksum": Fate(lines("corrupt"), gap=True),
    "unreadable": Fate(state("garbage"), (DeviceFault,), must=True, gap=True),
    "late reply": Fate(answers_late),
    "late samples": Fate(entered(LATE), (DeviceTimeout,), gap=True, old_s=0.4 + OLD_S),
    "duplicate": Fate(lines("repeat")),
    "the same again and again": Fate(state("frozen"), (ImplausibleReading,), must=True, gap=True),
    "wrong id": Fate(another, (NotConnected, DeviceRefused), must=True, gap=True),
    "no answer": Fate(entered(HUNG), (DeviceTimeout,), must=True, gap=True),
    "amplifier restarted": Fate(restarted, (DeviceTimeout,), must=True, gap=True),
}


def struck(fault: str) -> Strike:
    """One stream, one moment."""
    fate = FATES[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{fault} {seed}")

        async def main() -> None:
            book = FaultBook([HUNG, LATE, GONE])
            async with wired(NAME, plant_of("ideal"), book, reply_s=0.5, silence_s=0.5) as (amplifier, sensor):
                await sensor.connect()
                await _struck(At(amplifier, sensor, book, draw), fate)

        quickened(main(), SPEED)

    return strike


async def _struck(at: At, fate: Fate) -> None:
    reader = asyncio.create_task(_read(at, fate.old_s, 3.0))
    await asyncio.sleep(at.draw.uniform(0.05, 0.5))
    lift = await fate.strike(at)
    error: DeviceError | None = None
    missing = 0
    try:
        missing = await reader
    except DeviceError as told:
        assert isinstance(told, fate.errors), f"{told!r} in the place of {fate.errors}"
        error = told
    assert error is not None or not fate.must, "nobody noticed"
    assert error is not None or (missing > 0) == fate.gap, f"{missing} samples missing"
    await lift()
    for _ in range(50):
        with contextlib.suppress(DeviceError):
            await at.sensor.rearm()
            await at.sensor.block(1)
            break
        await asyncio.sleep(0.1)
    assert await _read(at, OLD_S, 0.3) == 0, "samples are still missing"


async def _read(at: At, old_s: float, seconds: float) -> int:
    """Blocks for so long; how many samples were missing between them. Each sample once, in order, and young."""
    loop, draw = asyncio.get_running_loop(), at.draw
    end_s, following, missing = loop.time() + seconds, None, 0
    while loop.time() < end_s:
        block = await at.sensor.block(draw.randint(1, 8))
        newest_s = block.time_s + (len(block.samples_n) - 1) * block.period_s
        assert loop.time() - newest_s < old_s, f"{loop.time() - newest_s:.3f} s old"
        assert abs(block.samples_n).max() < 5.0, f"{block.samples_n} was never measured"
        if following is not None:
            assert block.sequence >= following, "samples came twice"
            missing += block.sequence - following
        following = block.sequence + len(block.samples_n)
    return missing


STRIKES = {fault: struck(fault) for fault in FATES}
