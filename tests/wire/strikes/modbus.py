"""Strikes on devices behind Modbus, TCP and RTU on a pseudo-terminal: the true error, and nothing set twice."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from hal.bus.modbus_server import FaultKind, WireFault
from hal.codec.modbus import WRITE_MANY, ExceptionCode, Framing, Request
from hal.errors import CellError, DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, NotConnected, UnknownOutcome
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus import SimulatedModbus
from tests.contract.backends import plant_of, quickened
from tests.contract.fakes import fake_device
from tests.contract.wire_modbus import UNIT, device
from tests.wire.strikes import Lift, Strike

SPEED = 100.0
PTY_SPEED = 25.0
"""A busy kernel hands on a pseudo-terminal's bytes late: a coupler's second must not be over by then."""
WORST_S = 1.9
"""Just within the worst reply time of a device, beyond the deadline of an exchange."""
Errors = tuple[type[CellError], ...]


@dataclass
class At:
    """A device, its simulator and what was written."""

    made: Any
    simulated: SimulatedModbus
    plant: Plant
    framing: Framing
    path: Path
    writes: list[Request] = field(default_factory=list)

    async def plug(self) -> None:
        """There again, under the same address."""
        if self.framing == "tcp":
            await self.simulated.start()
        else:
            self.path.unlink(missing_ok=True)
            self.path.symlink_to(await self.simulated.start_pty())


@contextlib.asynccontextmanager
async def standing(name: str, framing: Framing) -> AsyncIterator[At]:
    """The device, connected."""
    plant, book = plant_of("ideal"), FaultBook()
    simulated = SimulatedModbus({UNIT: {0: fake_device(name, plant, book)}}, plant, book, framing)
    with tempfile.TemporaryDirectory() as folder:
        at = At(None, simulated, plant, framing, Path(folder) / "port")
        await at.plug()
        where = {"port": simulated.server.port} if framing == "tcp" else {"port_path": str(at.path), "parity": "N"}
        at.made = device(name, **where)
        simulated.server.watch = lambda one: at.writes.append(one) if one.function == WRITE_MANY else None  # type: ignore[arg-type]
        try:
            await at.made.connect()
            yield at
        finally:
            await at.made.close()
            await simulated.close()


# ------------------------------------------------------------ what is under way


async def reads(at: At) -> None:
    """Readings one after the other, each its own."""
    end_s, before_s = asyncio.get_running_loop().time() + 2.0, 0.0
    while asyncio.get_running_loop().time() < end_s:
        reading = await at.made.read()
        assert abs(reading.value - 20.0) < 2.0, f"{reading} is no answer to this question"
        assert at.framing == "rtu" or reading.time_s > before_s, "an answer was taken for another one"
        before_s = reading.time_s
        await asyncio.sleep(0.05)


async def swings(at: At) -> None:
    """The camera's arm into a view."""
    assert (await at.made.go("rotor")).position == "rotor"


async def loads(at: At) -> None:
    """A nut into a socket."""
    await at.made.load("a")


async def heats(at: At) -> None:
    """A set-point for the heater."""
    await at.made.heat(60.0, ramp_k_per_min=10.0, max_power_w=2000.0)
    await at.made.read()


async def well(at: At, work: str) -> None:
    """The device answers for the present, and what it was told was told once."""
    set_on = [one for one in at.writes if work in ("swings", "loads") and len(one.words) == 1 and one.words[0]]
    assert len(set_on) <= 1, f"set {len(set_on)} times"
    assert (await at.made.safe()).safe or work == "heats"
    match work:
        case "reads":
            await reads(at)
        case "swings":
            await at.made.go("parked")
            await swings(at)
        case "loads":
            before = at.plant.joints.socket_has_nut("a")  # type: ignore[attr-defined]
            if not before:
                assert await at.made.load("a")
        case "heats":
            await heats(at)


WORK: Mapping[str, tuple[str, Callable[[At], Awaitable[None]]]] = {
    "reads": ("spigot_tc_1", reads),
    "swings": ("camera_park", swings),
    "loads": ("nut_feeder", loads),
    "heats": ("heater", heats),
}

# ------------------------------------------------------------ what strikes


@dataclass(frozen=True, slots=True)
class Fate:
    """What strikes; `errors` may be told, with one of the `words`, or the work ends as if nothing were."""

    strike: Callable[[At, Random], Awaitable[Lift]]
    errors: Errors
    word: str = ""


async def pulled(at: At, draw: Random) -> Lift:
    """Nothing is there for a while."""
    await at.simulated.server.close()

    async def plug() -> None:
        await asyncio.sleep(draw.uniform(0.0, 5.0))
        await at.plug()

    return plug


async def silent(at: At, draw: Random) -> Lift:
    """No answer passes for a while."""
    at.simulated.server.faults.append(WireFault("silent", times=10**9))
    await asyncio.sleep(draw.uniform(0.5, 4.0))

    async def end() -> None:
        at.simulated.server.faults.clear()

    return end


def answers(kind: FaultKind, *, low: float = 0.0, high: float = 0.0) -> Callable[[At, Random], Awaitable[Lift]]:
    """One to three answers are spoilt."""

    async def strike(at: At, draw: Random) -> Lift:
        function = draw.choice((None, None, WRITE_MANY))
        fault = WireFault(kind, draw.uniform(low, high), draw.randint(1, 3), function)
        at.simulated.server.faults.append(fault)

        async def end() -> None:
            at.simulated.server.faults.clear()

        return end

    return strike


async def refusals(at: At, draw: Random) -> Lift:
    """An exception code, known or not."""
    code = draw.choice([*ExceptionCode, 99])
    at.simulated.server.faults.append(WireFault("exception", int(code)))

    async def end() -> None:
        at.simulated.server.faults.clear()

    return end


UNANSWERED = (DeviceTimeout, UnknownOutcome)
GONE = (NotConnected, UnknownOutcome, DeviceTimeout)
DROPPED = (*UNANSWERED, DeviceFault)
"""A coupler that could not be asked for its watchdog's time has dropped its outputs, and says so."""
ON_BOTH = {
    "adapter gone": Fate(pulled, (*GONE, DeviceFault)),
    "half frames": Fate(answers("half"), DROPPED),
    "late reply": Fate(answers("late", low=0.02, high=WORST_S), DROPPED),
    "late half of a reply": Fate(answers("late_half", low=0.02, high=WORST_S), DROPPED),
    "duplicate": Fate(answers("duplicate"), ()),
    "wrong id": Fate(answers("wrong_unit"), DROPPED),
    "exception codes": Fate(refusals, (DeviceRefused, DeviceFault, NotConnected, UnknownOutcome), "exception"),
    "too few registers": Fate(answers("short"), DROPPED),
    "no answer": Fate(silent, DROPPED),
}
FATES: Mapping[Framing, Mapping[str, Fate]] = {
    "tcp": ON_BOTH | {"cable pulled and plugged back": Fate(pulled, (*GONE, DeviceFault)),
                      "connection reset": Fate(answers("drop"), (*GONE, DeviceFault))},
    "rtu": ON_BOTH | {"cable pulled and plugged back": Fate(silent, DROPPED),
                      "wrong checksum": Fate(answers("corrupt"), DROPPED)},
}  # fmt: skip


def struck(framing: Framing, fault: str) -> Strike:
    """One piece of work, one moment."""
    fate = FATES[framing][fault]

    def strike(seed: int) -> None:
        draw = Random(f"{framing} {fault} {seed}")

        async def main() -> None:
            work = draw.choice(list(WORK))
            name, does = WORK[work]
            async with standing(name, framing) as at:
                at.writes.clear()
                doing = asyncio.ensure_future(does(at))
                await asyncio.sleep(draw.choice((0.0, draw.uniform(0.0, 0.2), draw.uniform(0.0, 2.0))))
                lift = await fate.strike(at, draw)
                try:
                    await doing
                except CellError as error:
                    assert isinstance(error, fate.errors), f"{work}: {error!r} in the place of {fate.errors}"
                    assert fate.word in str(error), f"{work}: {error!r} says nothing of {fate.word!r}"
                await lift()
                await _back(at)
                await well(at, work)

        quickened(main(), SPEED if framing == "tcp" else PTY_SPEED)

    return strike


async def _back(at: At) -> None:
    """Until it answers: the line opens anew, late answers are waited out, the coupler has dropped its outputs."""
    await asyncio.sleep(5.0)
    for _ in range(50):
        with contextlib.suppress(DeviceError):
            await at.made.rearm()
            return
        await asyncio.sleep(0.2)
    raise AssertionError("it does not come back")


TCP: dict[str, Strike] = {fault: struck("tcp", fault) for fault in FATES["tcp"]}
RTU: dict[str, Strike] = {fault: struck("rtu", fault) for fault in FATES["rtu"]}
