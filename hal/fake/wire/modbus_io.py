"""Chuck, camera arm, nut feeder, safety mirror and part station as registers of a Modbus coupler."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Coroutine
from typing import Any, Literal

from hal.bus.modbus_server import Refusal
from hal.codec import maps
from hal.codec.modbus import ExceptionCode
from hal.codec.registers import Bits, Block, RegisterField
from hal.errors import CellError, ConfigError, DeviceFault, DeviceRefused
from hal.fake.devices.supply import GUNS_BACK_MM, Sockets
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus_units import Part, Watchdog
from hal.interfaces import ChuckState, EnableState, ParkState, SafetyState

GUNS: tuple[Literal["a", "b"], ...] = ("a", "b")


class StrokePart(Part):
    """Outputs under a watchdog: an output that is set has the fake begin its stroke; cleared, the stroke ends there."""

    block: Block
    out: Bits
    writable = range(2)

    def __init__(self, fake: Any, faults: FaultBook, plant: Plant) -> None:
        super().__init__(fake, faults, self.block.size)
        self._plant = plant
        self._strokes: dict[str, asyncio.Task[None]] = {}
        self._watchdog = Watchdog(self._drop)
        self._dropped = False

    async def close(self) -> None:
        """End every stroke."""
        self._watchdog.stop()
        tasks = list(self._strokes.values())
        self._clear()
        await asyncio.gather(*tasks, return_exceptions=True)
        await super().close()

    async def refresh(self) -> None:
        """The inputs."""
        await self.look()
        self._fed()

    async def look(self) -> None:
        """Read the fake into the input registers."""
        raise NotImplementedError

    def stroke(self, output: str) -> Coroutine[Any, Any, object]:
        """What the fake does when `output` is set."""
        raise NotImplementedError

    async def written(self, at: int, before: list[int]) -> None:
        """Begin and end strokes."""
        await self.gate("outputs")
        outputs: frozenset[str] = self.get(self.out)
        if len(outputs) > self.most:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)
        self._dropped = False
        for output in self._strokes.keys() - outputs:
            self._strokes.pop(output).cancel()
        for output in outputs - self._strokes.keys():
            self._strokes[output] = asyncio.create_task(_quietly(self.stroke(output)), name=f"{self.name} {output}")
        self._fed()

    most = 1
    """How many outputs may be set at once."""

    def done(self, output: str) -> bool:
        """Whether the stroke of an output that is set has come to its end."""
        return output in self._strokes and self._strokes[output].done()

    def coupler(self) -> set[str]:
        """The bits that every coupler has."""
        now = asyncio.get_running_loop().time()
        return ({"dropped"} if self._dropped else set()) | (set() if self._faults.power_cut(now) else {"supply"})

    def _fed(self) -> None:
        if self._strokes:
            self._watchdog.feed(self.get(maps.IO_WATCHDOG_S))
        else:
            self._watchdog.stop()

    def _drop(self) -> None:
        """Silence for too long: every output off."""
        self._dropped = True
        self._clear()

    def _clear(self) -> None:
        self.words[self.out.at] = 0
        while self._strokes:
            self._strokes.popitem()[1].cancel()


class ChuckPart(StrokePart):
    """Two valves, three end switches, the pressure."""

    block, out = maps.CHUCK, maps.CHUCK_OUT

    async def look(self) -> None:
        """Feedbacks as the fake gives them; the jaws' open end switch from the plant."""
        state: ChuckState = await self.fake.read()
        inputs = self.coupler()
        inputs |= {"clamped_1"} if state.clamped_1 else set()
        inputs |= {"clamped_2"} if state.clamped_2 else set()
        moving = any(not task.done() for task in self._strokes.values())
        inputs |= set() if moving or self._plant.chuck_clamped else {"open"}
        self.words[maps.CHUCK_IN.at] = maps.CHUCK_IN.encode(frozenset(inputs))[0]
        self.words[maps.CHUCK_PRESSURE.at] = maps.CHUCK_PRESSURE.encode(state.pressure_bar)[0]

    def stroke(self, output: str) -> Coroutine[Any, Any, object]:
        """Close or open the jaws."""
        move: Coroutine[Any, Any, object] = self.fake.clamp() if output == "clamp" else self.fake.release()
        return move


class ParkPart(StrokePart):
    """An output and an end switch for each place."""

    block, out = maps.PARK, maps.PARK_OUT

    async def look(self) -> None:
        """The end switch that is set; two where they disagree."""
        state: ParkState = await self.fake.read()
        places = {state.position} if state.position else set()
        if self._faults.active(self.name, "disagree", state.time_s):
            places = {"parked", "rotor"}
        self.words[maps.PARK_IN.at] = maps.PARK_IN.encode(frozenset(self.coupler() | places))[0]

    def stroke(self, output: str) -> Coroutine[Any, Any, object]:
        """Swing."""
        swing: Coroutine[Any, Any, object] = self.fake.go(output)
        return swing


class FeederPart(StrokePart):
    """A slide and a presence sensor at each gun, and the counter."""

    block, out, most = maps.FEEDER, maps.FEEDER_OUT, 2

    async def look(self) -> None:
        """Slides, sockets and the counter."""
        count = await self.fake.count()
        now, joints = asyncio.get_running_loop().time(), self._plant.joints
        if not isinstance(joints, Sockets):
            raise ConfigError("the plant has no sockets", place=f"devices.{self.name}")
        inputs = self.coupler()
        if self._plant.motion["gun_feed"].position(now) <= GUNS_BACK_MM:
            inputs.add("guns_back")
        for gun in GUNS:
            inputs |= {f"out_{gun}"} if self.done(f"slide_{gun}") else set()
            inputs |= {f"nut_{gun}"} if joints.socket_has_nut(gun) else set()
        self.words[maps.FEEDER_IN.at] = maps.FEEDER_IN.encode(frozenset(inputs))[0]
        self.words[maps.FEEDER_COUNT.at] = maps.FEEDER_COUNT.encode(count)[0]

    def stroke(self, output: str) -> Coroutine[Any, Any, object]:
        """Bring one nut."""
        load: Coroutine[Any, Any, object] = self.fake.load(output.removeprefix("slide_"))
        return load


class EnablePart(Part):
    """One output that stays set while it is asked for in time; it falls for silence, and with its power."""

    writable = range(2)

    def __init__(self, fake: Any, faults: FaultBook, plant: Plant) -> None:
        super().__init__(fake, faults, maps.ENABLE.size)
        self._watchdog = Watchdog(lambda: self.fake.fall("nothing was heard for too long"))

    async def close(self) -> None:
        """Off."""
        self._watchdog.stop()
        await super().close()

    async def refresh(self) -> None:
        """The output as the metal has it. Being asked is a sign of life."""
        state: EnableState = await self.fake.read()
        cut = self._faults.power_cut(asyncio.get_running_loop().time())
        dropped = not state.enabled and bool(self.get(maps.ENABLE_OUT))
        inputs = ({"dropped"} if dropped else set()) | (set() if cut else {"supply"})
        self.words[maps.ENABLE_IN.at] = maps.ENABLE_IN.encode(frozenset(inputs))[0]
        if state.enabled:
            self._watchdog.feed(self.get(maps.IO_WATCHDOG_S))

    async def written(self, at: int, before: list[int]) -> None:
        """Set or clear the output."""
        if at != maps.ENABLE_OUT.at:
            await self.gate("watchdog")
        elif self.get(maps.ENABLE_OUT):
            await self.fake.allow()
            self._watchdog.feed(self.get(maps.IO_WATCHDOG_S))
        else:
            self._watchdog.stop()
            await self.fake.halt()


class SafetyPart(Part):
    """Two channels each of e-stop, guards and STO; the bench; a counter that grows ten times a second."""

    writable = range(maps.SAFETY_RESET_WORD.at, maps.SAFETY_SIZE)

    def __init__(self, fake: Any, faults: FaultBook, plant: Plant) -> None:
        super().__init__(fake, faults, maps.SAFETY_SIZE)

    async def refresh(self) -> None:
        """The mirror."""
        state: SafetyState = await self.fake.read()
        inputs: set[str] = set()
        for pair, said in (
            ("estop", state.estop_released),
            ("guards", state.guards_closed),
            ("sto", state.sto_released),
        ):
            inputs |= {True: {f"{pair}_1", f"{pair}_2"}, None: {f"{pair}_1"}, False: set()}[said]
        inputs |= {"bench_locked"} if state.bench_locked else set()
        inputs |= {"bench_moved"} if state.bench_moved else set()
        life = int(10.0 * state.time_s) & 0xFFFF
        self.put(maps.SAFETY_MIRROR, {maps.SAFETY_IN: frozenset(inputs), maps.SAFETY_COUNTER: life})

    async def written(self, at: int, before: list[int]) -> None:
        """Clear the latch of a moved bench."""
        await self.fake.rearm()


class StationPart(Part):
    """Jobs of the part station: one at a time, answered by their number."""

    writable = range(maps.STATION_JOB_WORD.at + 1)

    def __init__(self, fake: Any, faults: FaultBook, plant: Plant) -> None:
        super().__init__(fake, faults, maps.STATION_SIZE)
        self._job: asyncio.Task[None] | None = None

    async def close(self) -> None:
        """End the job."""
        await self._end()
        await super().close()

    async def written(self, at: int, before: list[int]) -> None:
        """A job's number starts it; 0 ends what is under way."""
        await self.gate("job")
        if at == maps.STATION_JOB_WORD.at:
            await self._end()
            if self.words[at] != 0:
                self._answer(maps.STATION_BUSY)
                self._job = asyncio.create_task(self._present(), name=f"{self.name} job")
            elif self.get(maps.STATION_RESULT) == maps.STATION_BUSY:
                self.words[maps.STATION_RESULT.at] = maps.STATION_FAILED

    async def _present(self) -> None:
        try:
            read = await self.fake.present(self.get(maps.WANTED_ROTOR), self.get(maps.WANTED_SHAFT))
        except DeviceRefused:
            self._answer(maps.STATION_JACK_UP)
        except DeviceFault:
            self._answer(maps.STATION_UNREADABLE)
        except CellError:
            self._answer(maps.STATION_FAILED)
        else:
            self._answer(maps.STATION_DONE, *read)

    async def _end(self) -> None:
        if self._job is not None:
            self._job.cancel()
            await asyncio.gather(self._job, return_exceptions=True)
            self._job = None

    def _answer(self, result: int, rotor: str = "", shaft: str = "") -> None:
        answer: dict[RegisterField[Any], Any] = {
            maps.ANSWERED_JOB: self.words[maps.STATION_JOB_WORD.at],
            maps.STATION_RESULT: result,
            maps.READ_ROTOR: rotor,
            maps.READ_SHAFT: shaft,
        }
        self.put(maps.STATION_ANSWER, answer)


async def _quietly(stroke: Coroutine[Any, Any, object]) -> None:
    """What went wrong on the way shows at the inputs."""
    with contextlib.suppress(CellError):
        await stroke
