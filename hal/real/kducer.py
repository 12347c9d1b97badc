"""A tightening gun behind a Kolver K-Ducer on Modbus TCP.

How the device and `hal.interfaces.Gun` meet:

* **Programs** are the controller's own and only read, never written (they live in its permanent memory): one must say
  the same name, windows, target, threshold and time limit. Sequences and programs that turn back are refused.
* **Start.** The remote lever is a coil that the controller lets go of, and stops, where it is not set again in time:
  that is its watchdog on this program. It is set again only while the controller was just read to be turning, never
  after a gap, a late answer or on another connection: a lever that is pressed again starts the program again.
* **Key.** The barcode, kept with the result: the key itself, or where it is too long 15 characters of its hash.
* **Result.** Known by its number and barcode, never by the new-result flag: that clears itself by being read, and its
  answer can be lost. The controller keeps its last result only. So the motor stays stopped from the end of a run to the
  preparation of the next one: nothing can take the place of a result that the caller has not written down.
* **Unknown.** A key that has neither the last result nor the barcode now set cannot be told anything about.
* **Safety.** "Stop motor" that stays on when it was taken off here is held by the controller's hard-wired input.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass

from hal.bus.modbus import Line, Link
from hal.codec import kducer as k
from hal.codec.registers import RegisterError
from hal.entries import KducerEntry
from hal.errors import (
    DeviceError,
    DeviceFault,
    DeviceRefused,
    DeviceTimeout,
    ImplausibleReading,
    Interrupted,
    NotConnected,
    SafetyOpen,
    UnknownOutcome,
)
from hal.interfaces import Band, Identity, SafeState, TighteningProgram, TighteningResult, Trace, TurnResult

OLDEST = 40
"""From this firmware on a result tells its limits, and no curve is sent unasked."""
LOOK_S, SELECT_S, READY_S, STAND_S, RESULT_S, GIVE_UP_S = 0.05, 0.4, 1.0, 1.0, 2.0, 10.0
"""A program is loaded after `SELECT_S`; once the spindle stands, its result is there within `RESULT_S`."""
ENDS_OF_TURNS = (k.ANGLE_OK, k.OVER_TORQUE, k.UNDER_ANGLE)
TURNING = frozenset(("lever", "forward"))


@dataclass(slots=True)
class _Run:
    """One program from its preparation, all on one connection, to its result. `held_s`: when the lever was set last."""

    barcode: str
    device: str
    before: int = 0
    held_s: float = 0.0
    connection: int = 0
    halted: bool = False

    def check(self) -> None:
        """Asked right before the motor is let go or the lever is set. Raises Interrupted."""
        if self.halted:
            raise Interrupted("halted on the way", device=self.device)


class KducerGun:
    """Implements `hal.interfaces.Gun`."""

    def __init__(self, name: str, entry: KducerEntry) -> None:
        self.name = name
        self._entry = entry
        self._line = Line(Link(entry.host, entry.port, deadline_s=entry.deadline_s))
        self._identity: Identity | None = None
        self._programs: dict[int, k.Program] = {}
        self._run: _Run | None = None
        self._started: set[str] = set()
        self._broken: set[str] = set()
        self._known: dict[str, TighteningResult | None] = {}

    async def connect(self) -> Identity:
        """Prove the identity, stop the motor, read the programs. Raises NotConnected, DeviceTimeout, DeviceRefused."""
        if self._identity is not None:
            return self._identity
        await self._line.open(self)
        try:
            identity = await self._who()
            await self._rest()
            self._programs = {n: await self._program(n) for n in range(1, self._entry.programs + 1)}
        except BaseException:
            await self.close()
            raise
        self._identity = identity
        return identity

    async def close(self) -> None:
        """Drop the link; the controller stops a program whose lever nobody holds."""
        self._identity = None
        await self._line.close(self)

    async def _who(self) -> Identity:
        tool, serial_high, serial_low, _ = await self._read(*k.TOOL)
        words = await self._read(*k.VERSION)
        with self._registers("version"):
            version = k.FIRMWARE.decode(words)
        serial = str(k.joined((serial_high, serial_low)))
        if self._entry.serial not in ("", serial):
            raise DeviceRefused(f"screwdriver {serial}, expected {self._entry.serial}", device=self.name)
        numbers = re.findall(r"\d+", version)
        if not numbers or int(numbers[-1][:2]) < OLDEST:
            raise DeviceRefused(f"firmware {version!r} is older than v{OLDEST}", device=self.name)
        if (await self._read(k.MODE, 1, holding=True))[0] != 0:
            raise DeviceRefused("is in sequence mode, programs are wanted", device=self.name)
        model = k.TOOLS[tool] if tool < len(k.TOOLS) else f"screwdriver {tool}"
        return Identity("Kolver", model, serial, version, simulated=version.startswith("SIM"))

    async def _read(self, start: int, count: int, *, holding: bool = False) -> tuple[int, ...]:
        return await self._line.read(self._entry.unit, start, count, device=self.name, holding=holding)

    async def _write(self, start: int, words: tuple[int, ...]) -> None:
        await self._line.write(self._entry.unit, start, words, device=self.name)
        back = await self._read(start, len(words), holding=True)
        if back != words:
            raise DeviceFault(f"register {start} not taken: wrote {words}, read back {back}", device=self.name)

    async def _status(self) -> frozenset[str]:
        coils = await self._line.coils(self._entry.unit, 0, len(k.STATUS), device=self.name)
        return frozenset(name for name, on in zip(k.STATUS, coils, strict=True) if on)

    async def _number(self) -> int:
        return k.joined(await self._read(*k.NUMBER))

    async def _last(self, *, again: bool = False) -> k.Result:
        """`again`: a read changes nothing, so a lost answer may be asked for once more."""
        if again:
            with contextlib.suppress(DeviceTimeout):
                return await self._last()
        words = await self._read(*k.RESULT)
        with self._registers("last result"):
            return k.read_result(words)

    async def _program(self, number: int) -> k.Program:
        words = await self._read(k.PROGRAM_SIZE * (number - 1), k.PROGRAM_SIZE, holding=True)
        with self._registers(f"program {number}"):
            return k.read_program(words)

    async def _given(self) -> str:
        """The barcode that is set now."""
        words = await self._read(*k.BARCODE_SET, holding=True)
        with self._registers("barcode"):
            return k.BARCODE.decode(words)

    async def halt(self) -> None:
        """Stop the motor and let go of the lever; returns once the spindle stands. Raises DeviceFault."""
        if self._run is not None:
            self._run.halted = True
        await self._rest()
        end_s = _now() + STAND_S
        while "forward" in await self._status():
            if _now() > end_s:
                raise DeviceFault(f"turns {STAND_S:g} s after its motor was stopped", device=self.name)
            await asyncio.sleep(LOOK_S)

    async def safe(self) -> SafeState:
        """Safe while the motor is off and the lever is let go of."""
        turning = TURNING & await self._status()
        return SafeState(not turning, "the spindle turns" if turning else "the spindle stands")

    async def rearm(self) -> None:
        """Leave the motor stopped and the lever let go of."""
        await self._rest()

    async def _rest(self) -> None:
        """To be repeated at will, so a broken link is told as such."""
        try:
            for coil, on in ((k.STOP_MOTOR, True), (k.LEVER, False)):
                await self._line.set_coil(self._entry.unit, coil, on, device=self.name)
        except UnknownOutcome as error:
            raise NotConnected(error.reason, device=self.name) from None

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        """Turn by the program for just this turn. Raises DeviceRefused, Interrupted, SafetyOpen, UnknownOutcome."""
        if not speed_rpm > 0.0:
            raise DeviceRefused(f"speed {speed_rpm} 1/min", device=self.name)
        with self._registers("turn", DeviceRefused):
            wanted = k.turn(angle_deg, speed_rpm, torque_limit_nm)
        result, _ = await self._perform(f"turn-{secrets.token_hex(5)}", wanted, abs(angle_deg) / (6.0 * speed_rpm))
        if result.code not in ENDS_OF_TURNS:
            raise DeviceFault(f"turn ended by {k.CODES.get(result.code, f'code {result.code}')}", device=self.name)
        signed = result.angle_deg if angle_deg >= 0.0 else -result.angle_deg
        return TurnResult(signed, result.peak_nm, _now())

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        """Run `program` once under `key`. Raises as `turn`; DeviceRefused for a key that was run before."""
        torque_nm = (program.torque_low_nm, program.torque_high_nm, program.target_torque_nm)
        angle_deg, clockwise = (program.angle_low_deg, program.angle_high_deg), program.direction == "tighten"
        with self._registers(program.stage, DeviceRefused):
            wanted = k.stage(
                program.stage, torque_nm, angle_deg, program.threshold_torque_nm, program.speed_rpm, program.timeout_s,
                clockwise=clockwise,
            )  # fmt: skip
        barcode = k.barcode_of(key)
        done = self._known[barcode] = self._told(key, *await self._perform(barcode, wanted, program.timeout_s))
        return done

    async def result(self, key: str) -> TighteningResult | None:
        """What is known under `key`. Raises UnknownOutcome where the controller cannot tell whether it was run."""
        barcode = k.barcode_of(key)
        if barcode in self._broken:
            raise UnknownOutcome(f"the lever may have been pressed twice in the run of {key}", device=self.name)
        if barcode in self._known:
            return self._known[barcode]
        end_s, give_up_s = _now() + RESULT_S, _now() + GIVE_UP_S
        while (last := await self._last(again=True)).barcode != barcode:
            if self._run is not None and self._run.barcode == barcode:
                return None
            if barcode != await self._given():
                raise UnknownOutcome(
                    f"only the last result is kept, of {last.barcode!r}; nothing is known of {key}", device=self.name
                )
            if TURNING & await self._status():
                end_s = _now() + RESULT_S
            if _now() > end_s:
                self._known[barcode] = None
                return None
            if _now() > give_up_s:
                raise UnknownOutcome(f"the spindle turns, and whether for {key} is not known", device=self.name)
            await asyncio.sleep(LOOK_S)
        done = self._known[barcode] = self._told(key, last, await self._curve(last))
        return done

    @contextlib.contextmanager
    def _registers(self, what: str, error: type[DeviceError] = ImplausibleReading) -> Iterator[None]:
        """What the registers cannot say is told as `error`."""
        try:
            yield
        except RegisterError as wrong:
            raise error(f"{what}: {wrong}", device=self.name) from None

    async def _perform(self, barcode: str, wanted: k.Program, limit_s: float) -> tuple[k.Result, k.Curve]:
        if self._run is not None:
            raise DeviceRefused("the spindle turns already", device=self.name)
        run = self._run = _Run(barcode, self.name)
        try:
            await self._set_up(run, wanted)
            await self._hold(run, _now() + limit_s + GIVE_UP_S)
            with contextlib.suppress(DeviceError):
                await self._rest()
            return await self._outcome(run)
        except Exception:
            with contextlib.suppress(DeviceError):
                await self._rest()
            raise
        except asyncio.CancelledError:
            self._line.errand(self._rest)  # not here: this task is on its way out
            raise
        finally:
            self._run = None

    async def _set_up(self, run: _Run, wanted: k.Program) -> None:
        """Everything up to the lever. The stopped motor is let go of last."""
        if (known := await self._who()) != self._identity:
            raise DeviceRefused(f"{known} answers instead of {self._identity}", device=self.name)
        run.connection = self._line.connection
        if TURNING & await self._status():
            raise DeviceRefused("the spindle turns already", device=self.name)
        last = await self._last()
        if run.barcode in self._started or run.barcode in (last.barcode, await self._given()):
            raise DeviceRefused(f"the key of barcode {run.barcode} was run before", device=self.name)
        await self._select(wanted)
        await self._write(k.BARCODE_SET[0], k.BARCODE.encode(run.barcode))
        run.before = last.number
        await self._line.set_coil(self._entry.unit, k.STOP_MOTOR, False, device=self.name, check=run.check)
        end_s = _now() + READY_S
        while "ready" not in (status := await self._status()):
            if _now() > end_s:
                if "stop_motor" in status:
                    raise SafetyOpen("no power (the input stop motor is on)", device=self.name)
                raise DeviceRefused(f"is not ready ({', '.join(sorted(status))})", device=self.name)
            await asyncio.sleep(LOOK_S)

    async def _select(self, wanted: k.Program) -> None:
        numbers = [number for number, known in self._programs.items() if known.essence == wanted.essence]
        if len(numbers) != 1:
            told = ", ".join(f"{number}: {known.name}" for number, known in self._programs.items() if known.name)
            how_many = "no program tells" if not numbers else f"programs {numbers} both tell"
            raise DeviceRefused(f"{how_many} {wanted} (the controller has {told})", device=self.name)
        (number,) = numbers
        now = await self._program(number)
        if now.essence != wanted.essence:
            raise DeviceRefused(f"program {number} was changed to {now}", device=self.name)
        if (await self._read(k.SELECTED, 1, holding=True))[0] != number:
            await self._write(k.SELECTED, (number,))
            await asyncio.sleep(SELECT_S)
        if (chosen := (await self._read(k.SELECTED, 1, holding=True))[0]) != number:
            raise DeviceFault(f"selects program {chosen} instead of {number}", device=self.name)

    async def _hold(self, run: _Run, end_s: float) -> None:
        """Press the lever and hold it until the program has ended, or something stands in doubt."""
        self._started.add(run.barcode)
        start_s, seen = _now(), False
        try:
            await self._press(run, first=True)
        except (Interrupted, DeviceRefused, NotConnected):
            self._started.discard(run.barcode)
            raise
        except DeviceError:
            return  # it may have started: it is held no longer
        try:
            while _now() < end_s:
                await asyncio.sleep(LOOK_S)
                if await self._number() != run.before:
                    return
                status = await self._status()
                run.check()
                if "stop_motor" in status:
                    raise SafetyOpen("no power (the input stop motor is on)", device=self.name)
                seen = seen or "forward" in status
                if "forward" not in status and (seen or _now() > start_s + READY_S):
                    return
                await self._press(run)
        except Interrupted:
            raise
        except DeviceError:
            return

    async def _press(self, run: _Run, *, first: bool = False) -> None:
        """Set the lever once. Whether it was still held when this one came must be beyond doubt.

        Raises Interrupted, DeviceTimeout (not sent after a gap, or answered late), and as `Line.set_coil`.
        """
        end_s, sent = math.inf if first else run.held_s + self._entry.lever_s, False

        def check() -> None:
            nonlocal sent
            run.check()
            if self._line.connection != run.connection:
                raise NotConnected("the link broke before the lever was set", device=self.name)
            if _now() > end_s:
                raise DeviceTimeout("the lever was not set again in time", device=self.name)
            sent, run.held_s = True, _now()

        try:
            await self._line.set_coil(self._entry.unit, k.LEVER, True, device=self.name, check=check)
            if _now() > end_s:
                raise DeviceTimeout("setting the lever again was answered late", device=self.name)
        except BaseException:
            if sent and not first:
                self._broken.add(run.barcode)
            raise

    async def _outcome(self, run: _Run) -> tuple[k.Result, k.Curve]:
        """The result of `run`, waited for while its spindle may turn and for a while after. Raises UnknownOutcome."""
        end_s, stands_s = _now() + GIVE_UP_S, math.inf
        while True:
            if run.barcode in self._broken:
                raise UnknownOutcome("the lever may have been let go of and pressed again", device=self.name)
            with contextlib.suppress(DeviceError):
                stands_s = math.inf if "forward" in await self._status() else min(stands_s, _now())
                last = await self._last()
                if last.number > run.before and last.barcode == run.barcode:
                    return last, await self._curve(last)
                if last.number != run.before:
                    break
            if self._identity is None or _now() > min(end_s, stands_s + RESULT_S):
                break
            await asyncio.sleep(LOOK_S)
        raise UnknownOutcome(f"no result came for {run.barcode}", device=self.name)

    async def _curve(self, result: k.Result) -> k.Curve:
        torque, angle = await self._read(*k.TORQUE_CURVE), await self._read(*k.ANGLE_CURVE)
        if await self._number() != result.number:
            raise DeviceFault(f"another result came while number {result.number} was read", device=self.name)
        return k.read_curve(torque, angle, result.tool)

    def _told(self, key: str, result: k.Result, curve: k.Curve) -> TighteningResult:
        trace = k.closed(curve, result)
        return TighteningResult(
            key=key,
            controller_serial=str(result.tool_serial),
            tightening_id=result.stamped_number,
            ok=result.ok,
            torque_nm=result.torque_nm,
            angle_deg=result.angle_deg,
            torque_band=_band(result.torque_nm, result.torque_low_nm, result.torque_high_nm),
            angle_band=_band(result.angle_deg, result.angle_low_deg, result.angle_high_deg),
            trace=Trace(trace.time_s, trace.angle_deg, trace.torque_nm),
            time_s=_now(),
        )


def _band(value: float, low: float, high: float) -> Band:
    return Band.LOW if value < low else Band.HIGH if value > high else Band.OK


def _now() -> float:
    return asyncio.get_running_loop().time()
