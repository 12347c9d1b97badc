"""Strikes on a gun behind Open Protocol, in any moment of a program: no nut twice, and no result lost for good."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from random import Random

from hal.codec import open_protocol_messages as m
from hal.codec.open_protocol import Message
from hal.errors import CellError, DeviceFault, DeviceRefused, DeviceTimeout, NotConnected, UnknownOutcome
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.gun import GunController
from hal.fake.wire.open_protocol import Client
from hal.real.gun import RESULT_S, OpenProtocolGun
from tests.wire.gun_stand import FREE, LONG, WIRE, linked, stand
from tests.wire.strikes import ESTOP, Lift, Strike, nothing, power_cut

Errors = tuple[type[CellError], ...]
LATE = Fault("gun_a", "late", phase="late", value=1.2, duration_s=6.0)


@dataclass(frozen=True, slots=True)
class At:
    """Where a fault strikes."""

    controller: GunController
    gun: OpenProtocolGun
    book: FaultBook
    draw: Random


@dataclass(frozen=True, slots=True)
class Fate:
    """`strike` at a moment of the program, or before it where `first`. `errors` may be told, or the result comes where
    it `may_end`. `kept`: what was started leaves a result that can be asked for."""

    strike: Callable[[At], Awaitable[Lift]]
    errors: Errors
    may_end: bool = True
    first: bool = False
    kept: bool = True


async def cable_pulled(at: At) -> Lift:
    """Nothing passes for a while, and neither side is told."""
    at.controller.wire.unplugged = True
    pulled_s = at.draw.uniform(0.1, 12.0)

    async def plug() -> None:
        at.controller.wire.unplugged = False

    asyncio.get_running_loop().call_later(pulled_s, setattr, at.controller.wire, "unplugged", False)
    return plug


async def dropped(at: At) -> Lift:
    """The connection is reset."""
    at.controller.drop()
    return nothing


async def half_messages(at: At) -> Lift:
    """What is sent comes in pieces, and the connection is reset amid them."""
    at.controller.wire.piece = at.draw.randint(2, 30)
    await asyncio.sleep(at.draw.uniform(0.0, 2.5))
    at.controller.drop()
    at.controller.wire.piece = 0
    return nothing


async def late_answers(at: At) -> Lift:
    """Each answer comes after a second."""
    at.book.enter_phase("late", asyncio.get_running_loop().time())
    return lambda: asyncio.sleep(LATE.duration_s)


async def late_result(at: At) -> Lift:
    """In time, or after nobody waits for it any more."""
    late_s = at.draw.uniform(0.1, 2.0 * RESULT_S)
    at.controller.wire.late_result_s = late_s

    async def end() -> None:
        at.controller.wire.late_result_s = 0.0
        await asyncio.sleep(late_s)

    return end


async def twice(at: At) -> Lift:
    """Each result is told twice, from here on."""
    at.controller.wire.repeat_results = True
    return nothing


async def strange(at: At) -> Lift:
    """Somebody else's result is told before."""
    at.controller.wire.strange_identifier = f"BY HAND {at.draw.randrange(100)}"
    return nothing


async def refusals(at: At) -> Lift:
    """MID 0004 with any code in the place of one request of the sequence."""
    mid = at.draw.choice((m.IDENTIFIER, m.SELECT, m.ENABLE, m.INPUT_SET))
    handlers, code = at.controller._handlers, at.draw.randint(1, 99)
    plain = handlers[mid]

    async def refused(client: Client, message: Message) -> list[Message]:
        handlers[mid] = plain
        return [m.refused(mid, code)]

    handlers[mid] = refused

    async def end() -> None:
        handlers[mid] = plain

    return end


async def keep_alive_lost(at: At) -> Lift:
    """Keep-alives are not answered."""
    at.controller.wire.mute = {m.KEEP_ALIVE}
    await asyncio.sleep(at.draw.uniform(5.0, 20.0))
    at.controller.wire.mute = set()
    await linked(at.gun)
    return nothing


async def result_lost(at: At) -> Lift:
    """It is stored, and never told."""
    at.controller.wire.lose_results = 1
    return nothing


async def restarted(at: At) -> Lift:
    """The controller's supply fails for a moment."""
    await at.controller.power_cycle()
    return nothing


LOST = (NotConnected, UnknownOutcome, DeviceTimeout)
FATES = {
    "cable pulled and plugged back": Fate(cable_pulled, LOST),
    "adapter gone": Fate(dropped, LOST),
    "half frames": Fate(half_messages, LOST),
    "late reply": Fate(late_answers, LOST),
    "late result": Fate(late_result, (UnknownOutcome,), first=True),
    "duplicate": Fate(twice, (), first=True),
    "wrong id": Fate(strange, (), first=True),
    "exception codes": Fate(refusals, (DeviceRefused, DeviceFault), may_end=False, first=True),
    "EMCY (alarm)": Fate(power_cut(linked), (DeviceFault,), kept=False),
    "lost heartbeat (keep-alive)": Fate(keep_alive_lost, (), first=True),
    "result lost and fetched again": Fate(result_lost, (UnknownOutcome,), may_end=False, first=True),
    "controller restart in mid-tightening": Fate(restarted, LOST, kept=False),
}


def struck(fault: str) -> Strike:
    """One program, one moment, and one more program afterwards."""
    fate = FATES[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{fault} {seed}")

        async def main() -> None:
            async with stand(LATE, ESTOP) as (controller, gun):
                await _struck(At(controller, gun, controller._faults, draw), fate)

        WIRE.run(main())

    return strike


async def _struck(at: At, fate: Fate) -> None:
    draw, gun, key = at.draw, at.gun, "k1"
    program = draw.choice((FREE, LONG))
    lift = await fate.strike(at) if fate.first else nothing
    tighten = asyncio.create_task(gun.tighten(key, program))
    if not fate.first:
        moments = (draw.uniform(0.0, 0.02), draw.uniform(0.0, 0.3), draw.uniform(0.0, 1.05 * program.timeout_s))
        await asyncio.sleep(draw.choice(moments))
        lift = await fate.strike(at)
    error: CellError | None = None
    try:
        assert (await tighten).key == key, "the result of another program"
        assert fate.may_end, "it ended as if nothing were"
    except CellError as told:
        assert isinstance(told, fate.errors), f"{told!r} in the place of {fate.errors}"
        error = told
    await lift()
    await linked(gun)
    await asyncio.sleep(program.timeout_s + 0.5)
    await judged(at, key, error, kept=fate.kept)


async def judged(at: At, key: str, error: CellError | None, *, kept: bool) -> None:
    """What was started was started once, is told when it is asked for, and is not started again."""
    started, stored = at.controller.starts.count(key), await at.gun.result(key)
    assert started <= 1, f"started {started} times"
    assert (started == 1) >= (stored is not None), "a result of what was never started"
    if kept or error is None:
        assert (stored is not None) == (started == 1), f"started {started} times, stored: {stored is not None}"
    if error is not None and not isinstance(error, UnknownOutcome):
        assert started == 0 or not kept, f"{error!r}, and it was started"
    if started:
        with contextlib.suppress(CellError):
            await at.gun.tighten(key, FREE)
        assert at.controller.starts.count(key) == started, "the same key was run again"
    assert (await at.gun.tighten("after", FREE)).key == "after"
    assert at.controller.starts.count("after") == 1
    assert at.controller.starts.count(key) == started


STRIKES = {fault: struck(fault) for fault in FATES}
