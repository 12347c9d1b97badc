"""What an Open Protocol controller has told: results, curves, selected set, whether the spindle turns, its alarm."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np

from hal.codec import open_protocol_messages as m
from hal.codec.open_protocol import Message, OpenProtocolError
from hal.codec.open_protocol_result import Result, read_result
from hal.codec.open_protocol_trace import ANGLE, TORQUE, Curve, Order, read_curve
from hal.interfaces import Band, TighteningResult, Trace

BANDS = {0: Band.LOW, 1: Band.OK, 2: Band.HIGH}
EMPTY = Trace(np.empty(0), np.empty(0), np.empty(0))
KEPT_CURVES = 8


class Records:
    """One per gun; outlives connections. `take` is given everything that the controller sends of its own accord."""

    def __init__(self, running_relay: int, order: Order) -> None:
        self._running_relay = running_relay
        self._order = order
        self._by_number: dict[int, Result] = {}
        self._by_identifier: dict[str, Result] = {}
        self._seen_s: dict[int, float] = {}
        self._curves: dict[tuple[int, int], Curve] = {}
        self._unacknowledged: set[int] = set()
        self._acknowledged: set[int] = set()
        self._news: asyncio.Future[None] | None = None
        self.absent: set[int] = set()
        """Tightenings that the controller was asked for and has no more."""
        self.curve_fault = ""
        """Why the last curve could not be read."""
        self.selected = 0
        self.running = False
        self.changed_s = 0.0
        """When `running` changed last, or was told first on this connection."""
        self.alarm: m.Alarm | None = None

    def new_session(self) -> None:
        """On a fresh connection the controller tells everything again."""
        self._unacknowledged.clear()
        self.selected = 0
        self.alarm = None
        self.running = False
        self.changed_s = _now()

    def take(self, message: Message) -> Message | None:
        """Note what `message` says; returns what is to be sent at once to acknowledge it."""
        answer = self._take(message)
        news, self._news = self._news, None
        if news is not None:
            news.set_result(None)
        return None if message.no_ack else answer

    def _take(self, message: Message) -> Message | None:
        if message.mid == m.RESULT:
            result = read_result(message)
            self.store(result)
            if result.number in self._acknowledged:
                return Message(m.RESULT_ACK)
            self._unacknowledged.add(result.number)
            return None
        if message.mid == m.TRACE:
            self.store_curve(message)
            return Message(m.ACCEPTED, b"0900")
        if message.mid == m.SELECTED:
            self.selected = m.read_selected(message)[0]
            return Message(m.SELECTED_ACK)
        if message.mid == m.RELAY:
            relay, on = m.read_relay(message)
            if relay == self._running_relay:
                self.running, self.changed_s = on, _now()
            return Message(m.RELAY_ACK)
        if message.mid in (m.ALARM, m.ALARM_STATUS):
            alarm = m.read_alarm(message)
            self.alarm = alarm if alarm.active else None
            return Message(m.ALARM_ACK if message.mid == m.ALARM else m.ALARM_STATUS_ACK)
        if message.mid == m.ALARM_GONE:
            self.alarm = None
            return Message(m.ALARM_GONE_ACK)
        return None

    def store(self, result: Result) -> None:
        """Keep a result, whichever way it came."""
        if result.number not in self._by_number:
            self._by_number[result.number] = self._by_identifier[result.identifier] = result
            self._seen_s[result.number] = _now()

    def store_curve(self, message: Message) -> None:
        """Keep a curve; only the last few are, because each is large."""
        try:
            curve = read_curve(message, self._order)
        except OpenProtocolError as error:
            self.curve_fault = str(error)
            return
        self._curves[curve.result, curve.kind] = curve
        while len(self._curves) > KEPT_CURVES:
            del self._curves[next(iter(self._curves))]

    def acknowledge(self) -> Message | None:
        """What acknowledges the results that have come; None where none is owed."""
        if not self._unacknowledged:
            return None
        self._acknowledged |= self._unacknowledged
        self._unacknowledged.clear()
        return Message(m.RESULT_ACK)

    @property
    def highest(self) -> int:
        """The highest tightening number that is known; 0 for none."""
        return max(self._by_number, default=0)

    def knows(self, number: int) -> bool:
        """Whether tightening `number` is here, or known to be nowhere."""
        return number in self._by_number or number in self.absent

    def of(self, identifier: str) -> Result | None:
        """The result under `identifier`."""
        return self._by_identifier.get(identifier)

    def has_curves(self, number: int) -> bool:
        """Whether torque and angle of tightening `number` are here."""
        return (number, TORQUE) in self._curves and (number, ANGLE) in self._curves

    def tightening(self, result: Result, serial: str) -> TighteningResult:
        """As the interface has it; the trace is empty where the curves are not here."""
        return TighteningResult(
            key=result.identifier,
            controller_serial=serial,
            tightening_id=result.number,
            ok=result.ok,
            torque_nm=result.torque_nm,
            angle_deg=float(result.angle_deg),
            torque_band=BANDS.get(result.torque_status, Band.HIGH),
            angle_band=BANDS.get(result.angle_status, Band.HIGH),
            trace=self._trace(result.number) if self.has_curves(result.number) else EMPTY,
            time_s=self._seen_s[result.number],
        )

    def _trace(self, number: int) -> Trace:
        torque, angle = self._curves[number, TORQUE], self._curves[number, ANGLE]
        return Trace(torque.time_s, np.interp(torque.time_s, angle.time_s, angle.values), torque.values)

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for `condition`, looked at whenever something was told; false where it does not come in time."""
        try:
            async with asyncio.timeout(seconds):
                while not condition():
                    if self._news is None:
                        self._news = asyncio.get_running_loop().create_future()
                    await asyncio.shield(self._news)
        except TimeoutError:
            return condition()
        return True


def _now() -> float:
    return asyncio.get_running_loop().time()
