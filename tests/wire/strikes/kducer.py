"""Strikes on the Kolver gun, in any moment of a program: no nut twice, and an outcome that is told or unknown."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from random import Random

from hal.bus.modbus_server import FaultKind, WireFault
from hal.codec.modbus import READ_COILS, READ_INPUT, WRITE_COIL, ExceptionCode
from hal.errors import (
    CellError,
    DeviceError,
    DeviceFault,
    DeviceRefused,
    DeviceTimeout,
    NotConnected,
    SafetyOpen,
    UnknownOutcome,
)
from hal.fake.faults import FaultBook
from hal.fake.wire.kducer import KducerController
from hal.real.kducer import KducerGun
from tests.wire.strikes import ESTOP, Lift, Strike, nothing, power_cut
from tests.wire.test_kducer import FREE, LONG, WIRE, known, linked, stand


@dataclass(frozen=True, slots=True)
class At:
    """Where a fault strikes."""

    controller: KducerController
    gun: KducerGun
    book: FaultBook
    draw: Random


@dataclass(frozen=True, slots=True)
class Fate:
    """`strike` before the program where `first`. `errors` may be told, and one must be where it `must`. `stored`: what
    was started leaves a result that can be asked for."""

    strike: Callable[[At], Awaitable[Lift]]
    errors: tuple[type[CellError], ...]
    must: bool = False
    first: bool = False
    stored: bool = False


async def pulled(at: At) -> Lift:
    """Nobody is there for a while; the lever is let go of."""
    await at.controller.server.close()

    async def plug() -> None:
        await at.controller.server.start()

    await asyncio.sleep(at.draw.uniform(0.0, 3.0))
    await plug()
    return nothing


async def dropped(at: At) -> Lift:
    """The connection is reset."""
    at.controller.drop()
    return nothing


def answers(kind: FaultKind, *, low: float = 0.0, high: float = 0.0) -> Callable[[At], Awaitable[Lift]]:
    """One to three answers are spoilt."""

    async def strike(at: At) -> Lift:
        function = at.draw.choice((None, READ_INPUT, READ_COILS, WRITE_COIL))
        fault = WireFault(kind, at.draw.uniform(low, high), at.draw.randint(1, 3), function)
        at.controller.server.faults.append(fault)

        async def end() -> None:
            at.controller.server.faults.clear()

        return end

    return strike


async def refusals(at: At) -> Lift:
    """An exception code, known or not."""
    at.controller.server.faults.append(WireFault("exception", int(at.draw.choice([*ExceptionCode, 99]))))

    async def end() -> None:
        at.controller.server.faults.clear()

    return end


async def result_lost(at: At) -> Lift:
    """What tells it is not answered for a while."""
    at.controller.lose_results = 1
    return nothing


async def restarted(at: At) -> Lift:
    """The controller's supply fails for a moment: it knows nothing any more."""
    await at.controller.power_cycle()
    return nothing


LOST = (NotConnected, UnknownOutcome, DeviceTimeout)
SPOILT = (*LOST, DeviceFault, DeviceRefused)
FATES = {
    "cable pulled and plugged back": Fate(pulled, LOST),
    "adapter gone": Fate(dropped, LOST),
    "half frames": Fate(answers("half"), LOST),
    "late reply": Fate(answers("late", low=0.02, high=1.9), LOST),
    "late half of a reply": Fate(answers("late_half", low=0.02, high=1.9), LOST),
    "duplicate": Fate(answers("duplicate"), ()),
    "wrong id": Fate(answers("wrong_unit"), LOST),
    "too few registers": Fate(answers("short"), SPOILT),
    "exception codes": Fate(refusals, SPOILT),
    "EMCY (power cut)": Fate(power_cut(linked), (DeviceFault, SafetyOpen, UnknownOutcome)),
    "result lost and fetched again": Fate(result_lost, (UnknownOutcome,), must=True, first=True, stored=True),
    "controller restart in mid-tightening": Fate(restarted, (*LOST, DeviceFault)),
}


def struck(fault: str) -> Strike:
    """One program, one moment, and one more program afterwards."""
    fate = FATES[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{fault} {seed}")

        async def main() -> None:
            async with stand(ESTOP) as (controller, gun):
                await _struck(At(controller, gun, controller._faults, draw), fate)

        WIRE.run(main())

    return strike


async def _struck(at: At, fate: Fate) -> None:
    draw, gun, key = at.draw, at.gun, "k1"
    program = FREE if fate.stored else draw.choice((FREE, LONG))
    lift = await fate.strike(at) if fate.first else nothing
    tighten = asyncio.create_task(gun.tighten(key, program))
    if not fate.first:
        moments = (draw.uniform(0.0, 0.05), draw.uniform(0.0, 0.5), draw.uniform(0.0, 0.5 + program.timeout_s))
        await asyncio.sleep(draw.choice(moments))
        lift = await fate.strike(at)
    error: CellError | None = None
    try:
        assert (await tighten).key == key, "the result of another program"
        assert not fate.must, "nobody noticed"
    except CellError as told:
        assert isinstance(told, fate.errors), f"{told!r} in the place of {fate.errors}"
        error = told
    await lift()
    await linked(gun)
    await judged(at, key, error, stored=fate.stored)


async def judged(at: At, key: str, error: CellError | None, *, stored: bool) -> None:
    """What was started was started once, and is not started again; what is told of it is true."""
    starts = at.controller.starts
    started, told = starts.count(key), await known(at.gun, key)
    assert started <= 1, f"started {started} times"
    if not isinstance(told, UnknownOutcome | None):
        assert started == 1, "a result of what was never started"
    assert not stored or not isinstance(told, UnknownOutcome | None), "its result cannot be had"
    if error is None:
        assert started == 1
    elif not isinstance(error, UnknownOutcome | SafetyOpen):
        assert started == 0, f"{error!r}, and it was started"
    if started and error is not None:
        with contextlib.suppress(CellError):
            await at.gun.tighten(key, FREE)
        assert starts.count(key) == started, "the same key was run again"
    await _one_more(at)


async def _one_more(at: At) -> None:
    for _ in range(20):
        try:
            assert (await at.gun.tighten("after", FREE)).key == "after"
        except NotConnected:
            await asyncio.sleep(0.5)
        except DeviceError as error:
            raise AssertionError(f"afterwards: {error!r}") from error
        else:
            break
    assert at.controller.starts.count("after") == 1


STRIKES = {fault: struck(fault) for fault in FATES}
