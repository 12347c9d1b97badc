"""Simulator of a Kolver K-Ducer: registers and coils on Modbus TCP outside, the fake gun on the plant inside.

As the maker's client has it: the remote lever is let go of where nobody sets it again, which stops the program without
a result; a new program starts only when the lever was let go of before; the controller keeps its last result only, and
numbers results from its power-up on; another program empties the barcode.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from hal.bus.modbus_server import ModbusServer, Refusal, Silence
from hal.codec import kducer as k
from hal.codec.modbus import READ_COILS, READ_HOLDING, READ_INPUT, WRITE_COIL, WRITE_MANY, ExceptionCode, Request
from hal.entries import KducerEntry
from hal.errors import CellError, DeviceTimeout, NotConnected, UnknownOutcome
from hal.fake.devices.guns import FakeGun
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.gun_memory import EPOCH, Program, TurnProgram
from hal.fake.wire.modbus_units import Watchdog
from hal.interfaces import Band, TighteningProgram, TighteningResult, Trace

LEVER_S = 1.0
"""The lever is let go of after this. What the real one does is not published; its maker sets it every 50 ms."""
LOST_S = 4.0
"""A lost result: so long the registers that tell it are not answered for."""
REPEATED_S = 1.0
"""A repeated result: so long the one before stays in the registers."""
TOOL = 7


@dataclass(frozen=True, slots=True)
class Ended:
    """What a program left; `late_s` after its end the registers tell it."""

    code: int
    torque_nm: float
    angle_deg: float
    trace: Trace | None = None
    late_s: float = 0.0


class KducerController:
    """One controller. `start` and `close` its network side; `close` also ends what runs. `server` has wire faults."""

    def __init__(
        self, name: str, entry: KducerEntry, plant: Plant, faults: FaultBook, programs: Sequence[Program]
    ) -> None:
        """`programs` are its programs, numbered from 1. The plant has its nuts (`install_joints`)."""
        self.name = name
        self.starts: list[str] = []
        """Barcodes of the programs that were started, in order."""
        self.lose_results = 0
        """So many results to come are lost: for `LOST_S` nothing that tells them is answered."""
        self.server = ModbusServer(self)
        self.server.port = entry.port
        self._faults = faults
        self._plant = plant
        self._gun = FakeGun(name, plant, BehindWire(faults))
        self._programs = dict(enumerate(programs, start=1))
        self._watchdog = Watchdog(self._let_go)
        self._tasks: set[asyncio.Task[None]] = set()
        self._holding = [0] * (k.BARCODE_SET[0] + k.BARCODE_SET[1])
        for number, program in self._programs.items():
            self.program(number, program)
        self._power_up()

    def _power_up(self) -> None:
        self._lever = self._stop = self._runs = False
        self._mute_until_s = 0.0
        self._number = 0
        self._input = [0] * (k.VERSION[0] + k.VERSION[1])
        self._set(self._input, k.TOOL[0], (TOOL, *k.split(1000 + ord(self.name[-1])), 0))
        self._set(self._input, k.VERSION[0], k.FIRMWARE.encode("SIM  KDU-1A vM.00.41"))
        self._select(1)

    @staticmethod
    def _set(registers: list[int], at: int, words: Sequence[int]) -> None:
        registers[at : at + len(words)] = words

    async def start(self) -> int:
        """Listen; returns the port."""
        await self._gun.connect()
        await self.server.start()
        return self.server.port

    async def close(self) -> None:
        """End everything."""
        await self.server.close()
        await self._end()

    def drop(self) -> None:
        """Drop every connection; whatever runs goes on until the lever is let go of."""
        self.server.drop()

    @property
    def turning(self) -> bool:
        """Whether a program runs."""
        return self._runs

    async def power_cycle(self) -> None:
        """Off and on: the program ends where it is; last result, number and barcode are gone."""
        self.server.drop()
        await self._gun.halt()
        await self._end()
        self._power_up()

    def program(self, number: int, program: Program) -> None:
        """What a technician does: another content for program `number`."""
        self._programs[number] = program
        self._set(self._holding, k.PROGRAM_SIZE * (number - 1), k.program_words(told(program)))

    async def _end(self) -> None:
        self._watchdog.stop()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._runs = False

    # ------------------------------------------------------------ registers and coils

    async def answer(self, request: Request) -> tuple[int, ...]:
        """What is read, or nothing for a write. Raises Refusal, Silence; a link that is gone is cut."""
        try:
            await self._faults.gate(self.name, "request")
        except NotConnected:
            raise ConnectionAbortedError from None
        except DeviceTimeout:
            raise Silence from None
        at, function = request.address, request.function
        if function == READ_INPUT:
            return self._tell(request)
        if function == READ_HOLDING:
            return self._slice(self._holding, request)
        if function == READ_COILS and at + request.count <= len(k.STATUS):
            status = self._status()
            return tuple(int(name in status) for name in k.STATUS[at : at + request.count])
        if function == WRITE_COIL and at in (k.LEVER, k.STOP_MOTOR):
            await self._coil(at, bool(request.words[0]))
        elif function == WRITE_MANY:
            self._write(request)
        else:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        return ()

    @staticmethod
    def _slice(registers: list[int], request: Request) -> tuple[int, ...]:
        end = request.address + request.count
        if end > len(registers):
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        return tuple(registers[request.address : end])

    def _tell(self, request: Request) -> tuple[int, ...]:
        words = self._slice(self._input, request)
        if k.RESULT[0] <= request.address < sum(k.RESULT) and _now() < self._mute_until_s:
            raise Silence
        if request.address <= k.NEW_RESULT < request.address + request.count:
            self._input[k.NEW_RESULT] = 0
        return words

    def _write(self, request: Request) -> None:
        if self._runs:
            raise Refusal(ExceptionCode.BUSY)
        if (request.address, request.count) == (k.SELECTED, 1) and request.words[0] in range(1, k.MOST_PROGRAMS + 1):
            self._select(request.words[0])
        elif (request.address, request.count) == k.BARCODE_SET:
            self._set(self._holding, request.address, request.words)
        else:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)

    def _select(self, number: int) -> None:
        self._holding[k.SELECTED] = number
        self._set(self._holding, k.BARCODE_SET[0], [0] * k.BARCODE_SET[1])

    def _status(self) -> frozenset[str]:
        stopped = self._stop or bool(self._faults.power_cut(_now())) or not self._plant.tools_enabled
        ready = not (stopped or self._runs or self._lever)
        states = {"lever": self._lever, "forward": self._runs, "stop_motor": stopped, "ready": ready}
        return frozenset(name for name, on in states.items() if on)

    async def _coil(self, at: int, on: bool) -> None:
        if at == k.STOP_MOTOR:
            self._stop = on
        elif on:
            self._watchdog.feed(LEVER_S)
            if "ready" in self._status():
                self._begin()
            self._lever = True
        else:
            self._watchdog.stop()
            self._lever = False
        if self._runs and (self._stop or not self._lever):
            await self._gun.halt()

    def _let_go(self) -> None:
        self._lever = False
        if self._runs:
            self._spawn(self._gun.halt())

    # ------------------------------------------------------------ programs

    def _begin(self) -> None:
        barcode = k.BARCODE.decode(self._holding[k.BARCODE_SET[0] : sum(k.BARCODE_SET)])
        number = self._holding[k.SELECTED]
        if number in self._programs:
            self.starts.append(barcode)
            self._runs = True
            self._spawn(self._run(number, barcode))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work, name=self.name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _run(self, number: int, barcode: str) -> None:
        """One program from start to end, whoever is connected."""
        program, start_s = self._programs[number], _now()
        try:
            ended = await (self._turn(program) if isinstance(program, TurnProgram) else self._tighten(program))
        except CellError:
            return  # halted, without power, or refused by the metal: no result
        finally:
            self._runs = False
        seconds = min(_now() - start_s, 65.0) if ended.trace is None else float(ended.trace.time_s[-1])
        await asyncio.sleep(ended.late_s)
        self._show(number, barcode, seconds, ended)

    async def _turn(self, program: TurnProgram) -> Ended:
        done = await self._gun.turn(
            program.angle_deg, speed_rpm=program.speed_rpm, torque_limit_nm=program.torque_limit_nm
        )
        short = abs(done.angle_deg) < abs(program.angle_deg) - 0.5
        return Ended(k.OVER_TORQUE if short else k.ANGLE_OK, done.peak_torque_nm, abs(done.angle_deg))

    async def _tighten(self, program: TighteningProgram) -> Ended:
        inner = f"{len(self.starts)}"  # a controller runs a barcode as often as it is told to
        done: TighteningResult | None = None
        with contextlib.suppress(UnknownOutcome):
            done = await self._gun.tighten(inner, program)
        stored = await self._gun.result(inner)
        assert stored is not None, "it has come to its end"
        if done is None or self.lose_results:
            self.lose_results = max(self.lose_results - 1, 0)
            self._mute_until_s = _now() + LOST_S
        late_s = REPEATED_S if done is not None and done.key != inner else 0.0
        return Ended(_code(stored), stored.torque_nm, stored.angle_deg, stored.trace, late_s)

    def _show(self, number: int, barcode: str, seconds: float, ended: Ended) -> None:
        program = told(self._programs[number])
        self._number += 1
        now = EPOCH + timedelta(seconds=_now())
        result = k.Result(
            barcode=barcode,
            number=self._number,
            ok=ended.code in (k.SCREW_OK, k.ANGLE_OK),
            program=number,
            tool=TOOL,
            tool_serial=k.joined(self._input[k.TOOL[0] + 1 : k.TOOL[0] + 3]),
            seconds=seconds,
            torque_nm=max(ended.torque_nm, 0.0),
            peak_nm=max(ended.torque_nm, 0.0),
            angle_deg=max(ended.angle_deg, 0.0),
            code=ended.code,
            name=program.name,
            stamp=(now.year - 2000, now.month, now.day, now.hour, now.minute, now.second),
            torque_low_nm=program.torque_low_nm,
            torque_high_nm=program.torque_high_nm,
            angle_low_deg=program.angle_low_deg,
            angle_high_deg=program.angle_high_deg,
        )
        torque, angle = k.curve_words(thinned(ended.trace), TOOL)
        self._set(self._input, k.RESULT[0], k.result_words(result))
        self._set(self._input, k.TORQUE_CURVE[0], torque)
        self._set(self._input, k.ANGLE_CURVE[0], angle)
        self._input[k.NEW_RESULT] = 1


def told(program: Program) -> k.Program:
    """What the controller tells of one of its programs."""
    if isinstance(program, TurnProgram):
        return k.turn(program.angle_deg, program.speed_rpm, program.torque_limit_nm)
    return k.stage(
        program.stage,
        (program.torque_low_nm, program.torque_high_nm, program.target_torque_nm),
        (program.angle_low_deg, program.angle_high_deg),
        program.threshold_torque_nm,
        program.speed_rpm,
        program.timeout_s,
        clockwise=program.direction == "tighten",
    )


def thinned(trace: Trace | None) -> k.Curve:
    """As many points as the registers hold, at equal whole milliseconds; the angle counts from the first."""
    if trace is None or len(trace.time_s) < 2:
        return k.Curve(np.empty(0), np.empty(0), np.empty(0))
    most = k.TORQUE_CURVE[1] - 1
    interval_s = 1e-3 * np.ceil(1e3 * trace.time_s[-1] / most)
    time_s = interval_s * np.arange(min(most, int(trace.time_s[-1] / interval_s) + 1))
    angle_deg = np.interp(time_s, trace.time_s, trace.angle_deg - trace.angle_deg[0])
    return k.Curve(time_s, angle_deg, np.interp(time_s, trace.time_s, trace.torque_nm))


def _code(done: TighteningResult) -> int:
    if done.ok:
        return k.SCREW_OK
    if done.torque_band is Band.OK:
        return k.OVER_ANGLE if done.angle_band is Band.HIGH else k.UNDER_ANGLE
    return k.OVER_TORQUE if done.torque_band is Band.HIGH else k.TOO_LONG


def _now() -> float:
    return asyncio.get_running_loop().time()
