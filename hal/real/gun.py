"""A tightening gun behind an Open Protocol controller.

How the protocol and `hal.interfaces.Gun` meet:

* **Parameter sets.** The protocol cannot say what a program is, only select one of the controller's. Each set of the
  controller is read back at connect; a program is run by the set that tells the same name, windows and target, and
  that set is read again before each run. A program that no set tells is refused, and so is one that two sets tell.
* **Key.** MID 0050 gives it to the controller, which stores it with the result. A key that was started here, or that
  the controller's memory knows, is refused.
* **Result.** It is acknowledged (MID 0062) when the next run or question comes: by then the caller has written it
  down, since it asks for nothing more before that. Until then, and after a lost link, the controller keeps it and
  tells it again; a result is known by its number and counts once. A result that is not the present run's, and so may
  stand before it in the controller's queue, is acknowledged at once: the controller's memory has it still.
* **Lost link.** The tightening goes on. The link comes back by itself, missed results are fetched with MID 0064, and
  only where the spindle stands and no result is to be had the outcome is unknown.
* **Start.** MID 0224 is sent once; where its answer is lost the run counts as started.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from hal.bus.open_protocol import Link, Refused, Session
from hal.codec import open_protocol_messages as m
from hal.codec import open_protocol_trace as t
from hal.codec.open_protocol import Message, OpenProtocolError
from hal.codec.open_protocol_result import Result
from hal.entries import OpenProtocolEntry
from hal.errors import (
    CellError,
    DeviceError,
    DeviceFault,
    DeviceRefused,
    Interrupted,
    NotConnected,
    SafetyOpen,
    UnknownOutcome,
)
from hal.interfaces import Identity, SafeState, TighteningProgram, TighteningResult, TurnResult
from hal.real import gun_session as asking
from hal.real.gun_records import Records

KEY_LENGTH = 25
HISTORY = 200
"""So many stored results are searched for a key."""
SELECT_S = 2.0
STAND_S = 1.0
"""A disabled spindle stands after this."""
RESULT_S = 3.0
"""After the spindle stands, its result and its curves are waited for so long."""
MARGIN_S = 10.0
"""Beyond the program's own time limit."""
LOOK_S = 0.25


@dataclass(slots=True)
class _Run:
    """One program from its preparation to its result."""

    identifier: str
    device: str
    started_s: float = 0.0
    halted: bool = False
    result: asyncio.Future[Result] = field(default_factory=lambda: asyncio.get_running_loop().create_future())

    def fail(self, error: CellError) -> None:
        """End it without a result, unless it has one."""
        if not self.result.done():
            self.result.set_exception(error)
            self.result.exception()

    def check(self) -> None:
        """Asked right before anything is sent. Raises Interrupted."""
        if self.halted:
            raise Interrupted("halted before it was started", device=self.device)


class OpenProtocolGun:
    """Implements `hal.interfaces.Gun`."""

    def __init__(self, name: str, entry: OpenProtocolEntry) -> None:
        self.name = name
        self._entry = entry
        self._records = Records(entry.running_relay, entry.trace_order)
        self._link = Link(entry.host, entry.port, device=name, prepare=self._prepare, on_event=self._on_event)
        self._identity: Identity | None = None
        self._sets: tuple[m.ParameterSet, ...] = ()
        self._started: set[str] = set()
        self._run: _Run | None = None

    # ------------------------------------------------------------ link

    async def connect(self) -> Identity:
        """Open the link. Raises NotConnected, DeviceTimeout, DeviceRefused (another controller, no curves)."""
        await self._link.open()
        assert self._identity is not None  # the link's preparation has set it
        return self._identity

    async def close(self) -> None:
        """Drop the link; a program that runs goes on without us."""
        if self._run is not None:
            self._run.fail(UnknownOutcome("closed while the program ran", device=self.name))
        if self._link.up:
            self._link.session().tell(Message(m.STOP))
        await self._link.close()

    async def _prepare(self, session: Session) -> None:
        self._records.new_session()
        with self._readable():
            identity = await asking.begin(session, self.name)
            wanted = self._entry.serial or (self._identity.serial if self._identity is not None else "")
            if wanted and identity.serial != wanted:
                raise DeviceRefused(f"controller {identity.serial} answers instead of {wanted}", device=self.name)
            await asking.subscribe(session, self._entry.running_relay, self.name)
            self._sets = await asking.parameter_sets(session)
            await self._catch_up(session)
        self._identity = identity
        self._records.changed_s = asyncio.get_running_loop().time()

    @contextlib.contextmanager
    def _readable(self) -> Iterator[None]:
        """What the controller says inside must be readable. Raises DeviceFault."""
        try:
            yield
        except OpenProtocolError as error:
            raise DeviceFault(str(error), device=self.name) from None

    def _on_event(self, session: Session, message: Message) -> None:
        acknowledgement = self._records.take(message)
        if acknowledgement is not None:
            session.tell(acknowledgement)
        self._settle()
        if self._run is not None and not self._run.result.done():
            self._acknowledge(session)
        told = message.mid in (m.ALARM, m.ALARM_STATUS)
        if told and self._run is not None and self._run.started_s and (fault := self._alarm()) is not None:
            self._run.fail(fault)

    def _settle(self) -> None:
        """Give the present run its result, if it has come."""
        run = self._run
        if run is None or not run.started_s or run.result.done():
            return
        if (result := self._records.of(run.identifier)) is not None:
            run.result.set_result(result)

    def _alarm(self) -> CellError | None:
        """The error that the controller's alarm means while it keeps the tool from turning."""
        alarm = self._records.alarm
        if alarm is None or (alarm.tool_ready and alarm.controller_ready):
            return None
        if alarm.code in self._entry.estop_alarms:
            return SafetyOpen(f"no power (alarm {alarm.code})", device=self.name)
        return DeviceFault(f"alarm {alarm.code}", device=self.name)

    # ------------------------------------------------------------ safe state

    async def halt(self) -> None:
        """Disable the tool; returns once the spindle stands. Raises DeviceFault where it does not."""
        run = self._run
        if run is not None:
            run.halted = True
        await self._link.session().ask(Message(m.DISABLE))
        if not await self._records.until(lambda: not self._records.running, STAND_S):
            raise DeviceFault(f"turns {STAND_S:g} s after it was disabled (MID 0042)", device=self.name)
        if run is not None:
            run.fail(Interrupted("halted on the way", device=self.name))

    async def safe(self) -> SafeState:
        """Safe while the spindle stands. What was told before the keep-alive's answer is the present state."""
        await self._link.session().ask(Message(m.KEEP_ALIVE))
        turning = self._records.running
        return SafeState(not turning, "the spindle turns" if turning else "the spindle stands")

    async def rearm(self) -> None:
        """Leave the tool disabled and acknowledge the controller's alarm."""
        session = self._link.session()
        await session.ask(Message(m.DISABLE))
        if self._records.alarm is not None:
            await session.ask(Message(m.ALARM_CLEAR))

    # ------------------------------------------------------------ runs

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        """Turn by the set for just this turn. Raises DeviceRefused, Interrupted, SafetyOpen, UnknownOutcome."""
        self._link.session()
        if not (speed_rpm > 0.0 and all(math.isfinite(x) for x in (angle_deg, speed_rpm, torque_limit_nm))):
            wrong = f"{angle_deg} deg at {speed_rpm} 1/min up to {torque_limit_nm} N m"
            raise DeviceRefused(f"cannot turn {wrong}", device=self.name)
        size = abs(angle_deg)
        torque = (0.0, torque_limit_nm, torque_limit_nm)
        wanted = m.told_set("turn", speed_rpm, 1 if angle_deg >= 0.0 else 2, torque, (0.0, size, size))
        limit_s = size / (6.0 * speed_rpm) + MARGIN_S
        result = await self._perform(f"turn-{secrets.token_hex(8)}", wanted, limit_s)
        signed = float(result.angle_deg if angle_deg >= 0.0 else -result.angle_deg)
        return TurnResult(signed, result.torque_nm, asyncio.get_running_loop().time())

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        """Run `program` once under `key`. Raises as `turn`; DeviceRefused for a key that was run before."""
        self._link.session()
        if not (0 < len(key) <= KEY_LENGTH and key.isascii() and key.isprintable() and key == key.strip()):
            raise DeviceRefused(f"key {key!r} is not 1 to {KEY_LENGTH} printable ASCII characters", device=self.name)
        wanted = m.told_set(
            program.stage,
            program.speed_rpm,
            1 if program.direction == "tighten" else 2,
            (program.torque_low_nm, program.torque_high_nm, program.target_torque_nm),
            (program.angle_low_deg, program.angle_high_deg, 0.0),
        )
        result = await self._perform(key, wanted, program.timeout_s + MARGIN_S)
        return await self._with_curves(result)

    async def result(self, key: str) -> TighteningResult | None:
        """What the controller stored under `key`, its last `HISTORY` results searched."""
        session = self._link.session()
        with self._readable():
            found = await self._search(session, key)
        self._acknowledge(session)
        return None if found is None else await self._with_curves(found, wait_s=0.0)

    async def _perform(self, identifier: str, wanted: m.ParameterSet, limit_s: float) -> Result:
        session = self._link.session()
        if self._run is not None or self._records.running:
            raise DeviceRefused("the spindle turns already", device=self.name)
        run = self._run = _Run(identifier, self.name)
        try:
            self._acknowledge(session)
            with self._readable():
                await self._set_up(session, run, wanted)
            await self._start(session, run)
            result = await self._outcome(run, limit_s)
        except Exception:
            await self._disable()
            raise
        finally:
            self._run = None
        await self._disable()
        return result

    def _acknowledge(self, session: Session) -> None:
        if (acknowledgement := self._records.acknowledge()) is not None:
            session.tell(acknowledgement)

    async def _disable(self) -> None:
        """Nothing depends on it: the enable output under the I/O watchdog is what keeps an idle tool from turning."""
        with contextlib.suppress(DeviceError):
            await self._link.session().ask(Message(m.DISABLE))

    async def _set_up(self, session: Session, run: _Run, wanted: m.ParameterSet) -> None:
        if run.identifier in self._started or await self._search(session, run.identifier) is not None:
            raise DeviceRefused(f"key {run.identifier} was run before", device=self.name)
        numbers = [known.number for known in self._sets if _same(known, wanted)]
        if len(numbers) != 1:
            told = ", ".join(f"{known.number}: {known.name}" for known in self._sets)
            how_many = "no parameter set tells" if not numbers else f"parameter sets {numbers} both tell"
            raise DeviceRefused(f"{how_many} {_words(wanted)} (the controller has {told})", device=self.name)
        known = await asking.parameter_set(session, numbers[0])
        if not _same(known, wanted):
            raise DeviceRefused(f"parameter set {known.number} was changed to {_words(known)}", device=self.name)
        await session.ask(Message(m.IDENTIFIER, run.identifier.ljust(KEY_LENGTH).encode("ascii")), guard=run.check)
        await session.ask(m.numbered(m.SELECT, known.number, 3), guard=run.check)
        if not await self._records.until(lambda: self._records.selected == known.number, SELECT_S):
            chosen = self._records.selected
            raise DeviceFault(f"selects parameter set {chosen} instead of {known.number}", device=self.name)
        await session.ask(Message(m.ENABLE), guard=run.check)

    async def _start(self, session: Session, run: _Run) -> None:
        """Where the answer is lost the run counts as started."""
        self._started.add(run.identifier)
        run.started_s = asyncio.get_running_loop().time()
        try:
            start = m.numbered(m.INPUT_SET, self._entry.start_input, 3)
            await session.ask(start, repeatable=False, guard=run.check)
        except UnknownOutcome:
            return
        except Refused as error:
            self._started.discard(run.identifier)
            raise self._alarm() or error from None
        except (Interrupted, NotConnected):
            self._started.discard(run.identifier)
            raise

    async def _outcome(self, run: _Run, limit_s: float) -> Result:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + limit_s
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    return await asyncio.shield(run.result)
            now = loop.time()
            stands = self._link.up and not self._records.running
            if stands and now - max(run.started_s, self._records.changed_s) > RESULT_S:
                raise UnknownOutcome(f"the spindle stands and no result came for {run.identifier}", device=self.name)
            if now > end_s:
                raise UnknownOutcome(f"no result came for {run.identifier} within {limit_s:g} s", device=self.name)

    # ------------------------------------------------------------ the controller's memory

    async def _catch_up(self, session: Session) -> None:
        """Fetch the latest result and, where others were known, all that came between."""
        known = self._records.highest
        latest = await asking.old_result(session, 0)
        if latest is None:
            return
        if known:
            for number in range(max(known + 1, latest.number - HISTORY), latest.number):
                await self._fetch(session, number)
        self._records.store(latest)
        self._settle()

    async def _fetch(self, session: Session, number: int) -> None:
        if self._records.knows(number):
            return
        found = await asking.old_result(session, number)
        if found is None:
            self._records.absent.add(number)
        else:
            self._records.store(found)

    async def _search(self, session: Session, key: str) -> Result | None:
        """The result under `key`: first the latest ones, then back through the controller's memory."""
        await self._catch_up(session)
        last = self._records.highest
        for number in range(last - 1, max(0, last - HISTORY), -1):
            if self._records.of(key) is not None:
                break
            await self._fetch(session, number)
        return self._records.of(key)

    async def _with_curves(self, result: Result, *, wait_s: float = RESULT_S) -> TighteningResult:
        """The curves come behind the result; those that do not are asked for. Without them the trace is empty."""
        records, number = self._records, result.number
        if not records.has_curves(number) and not await records.until(lambda: records.has_curves(number), wait_s):
            with contextlib.suppress(DeviceError):
                for kind in (t.ANGLE, t.TORQUE):
                    if (curve := await asking.old_curve(self._link.session(), number, kind)) is not None:
                        records.store_curve(curve)
            if not records.has_curves(number) and records.curve_fault:
                raise DeviceFault(records.curve_fault, device=self.name)
        serial = self._identity.serial if self._identity is not None else ""
        return records.tightening(result, serial)


def _same(known: m.ParameterSet, wanted: m.ParameterSet) -> bool:
    return replace(known, number=0, batch=0) == wanted


def _words(wanted: m.ParameterSet) -> str:
    way = "clockwise" if wanted.direction == 1 else "counter-clockwise"
    return (
        f"{wanted.name!r} {way} to {wanted.torque_nm:g} N m in {wanted.torque_low_nm:g} to {wanted.torque_high_nm:g}, "
        f"{wanted.angle_deg} deg in {wanted.angle_low_deg} to {wanted.angle_high_deg}"
    )
