"""A CANopen node of a simulated drive on the hub: SDO server, PDOs, heartbeats both ways, emergencies, and its faults.

Faults of the book: ``gone`` (cable out: neither hears nor says anything), ``hung`` (beats, but answers nothing),
``late`` (answers late). Beyond that, a test can use `restart`, `emergency`, `muted`, `abort_next` and `late_next`.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

from hal.codec import cia301 as cia
from hal.codec import sdo
from hal.codec.cia301 import Emergency, Entry, Malformed, NmtCommand, NmtState
from hal.codec.cia402 import HEARTBEAT_ERROR
from hal.codec.lawicel import CanFrame
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.drive import Drive

UNREAD_S = 0.002
"""What has come is read within this."""
BOOT_S = 0.2
"""From supply to boot-up message."""
_TEXTS = {0x1008: b"servo drive", 0x100A: b"1.0"}
_PDOS = {cia.RPDO1: 0x1400, cia.RPDO2: 0x1401, cia.TPDO1: 0x1800, cia.TPDO2: 0x1801}


class Bus(Protocol):
    """What a node needs of the hub."""

    def attach(self, deliver: Callable[[CanFrame], None]) -> tuple[Callable[[CanFrame], None], Callable[[], None]]: ...


class CanNode:
    """Node `number` on `bus`; made inside the running loop."""

    def __init__(
        self, bus: Bus, number: int, name: str, plant: Plant, faults: FaultBook, *, scale: float, feed: int
    ) -> None:
        self._number, self._name, self._faults = number, name, faults
        self._loop = asyncio.get_running_loop()
        self.drive = Drive(name, plant, faults, scale, feed, changed=self._changed, emergency=self._tell)
        self._sdo = sdo.SdoServer(self._read, self._write)
        self._store = self._defaults()
        self.state = NmtState.PRE_OPERATIONAL
        self.muted = False
        """Whether its heartbeat is held back."""
        self.abort_next: list[int] = []
        """Abort codes for the next SDO requests, whatever they ask."""
        self.late_next: dict[int, float] = {}
        """Seconds by which the next SDO reply about an object (its index) is late, while heartbeats go on."""
        self._shown: bytes | None = None
        self._handles: dict[str, asyncio.TimerHandle] = {}
        self._queued: deque[Callable[[], None]] = deque()
        self._timers: set[asyncio.TimerHandle] = set()
        self._free_s = 0.0
        self._send, self._detach = bus.attach(self._receive)

    def close(self) -> None:
        """Off the bus; no timer is left."""
        self._detach()
        self.drive.close()
        for handle in (*self._handles.values(), *self._timers):
            handle.cancel()

    def restart(self) -> None:
        """The supply fails for a moment: everything set is lost, and it says so with a boot-up message."""
        for handle in self._handles.values():
            handle.cancel()
        self._store = self._defaults()
        self.state = NmtState.BOOT_UP
        self.drive.restart()
        self._again("boot", BOOT_S, self._boot)

    # ------------------------------------------------------------ network management

    def _boot(self) -> None:
        self._out(CanFrame(cia.HEARTBEAT + self._number, bytes([NmtState.BOOT_UP])))
        self.state = NmtState.PRE_OPERATIONAL

    def _beat(self) -> None:
        period_s = self._value(cia.PRODUCER_HEARTBEAT) * 1e-3
        if period_s > 0.0:
            if not self.muted:
                self._out(cia.heartbeat(self._number, self.state))
            self._again("beat", period_s, self._beat)

    def _command(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self._number):
            return
        match data[0]:
            case NmtCommand.START:
                self.state, self._shown = NmtState.OPERATIONAL, None
                self._changed()
                self._cycle()
            case NmtCommand.STOP:
                self.state = NmtState.STOPPED
            case NmtCommand.ENTER_PRE_OPERATIONAL:
                self.state = NmtState.PRE_OPERATIONAL
            case NmtCommand.RESET_NODE | NmtCommand.RESET_COMMUNICATION:
                self.restart()

    def _heard(self, node: int) -> None:
        """The consumer heartbeat begins with the first beat of whom it is set to (CiA 301, 7.2.8.3.2.2)."""
        expected, time_ms = divmod(self._value(cia.CONSUMER_HEARTBEAT), 1 << 16)
        if node == expected and time_ms > 0:
            self._again("controller", time_ms * 1e-3, self._overdue)

    def _overdue(self) -> None:
        """On a desk that was busy the beats may have come, and not been read yet."""
        self._again("controller", UNREAD_S, self._missed)

    def _missed(self) -> None:
        self._tell(HEARTBEAT_ERROR)
        self.drive.connection_lost()

    def _tell(self, code: int) -> None:
        self._out(CanFrame(cia.EMCY + self._number, Emergency(code, 0x21 if code else 0).encode()))

    def emergency(self, code: int) -> None:
        """The drive trips with `code`."""
        self.drive.fail(code)

    # ------------------------------------------------------------ frames

    def _receive(self, frame: CanFrame) -> None:
        now = self._loop.time()
        if self.state is NmtState.BOOT_UP or self._faults.active(self._name, "gone", now):
            return
        delay_s = 0.0
        if hung := self._faults.active(self._name, "hung", now):
            delay_s = self._faults.start_s(hung) + hung.duration_s - now
        if math.isinf(delay_s):
            return
        if delay_s > 0.0 and frame.can_id < cia.HEARTBEAT:
            self._queue(delay_s, lambda: self._handle(frame))
        else:
            self._handle(frame)

    def _handle(self, frame: CanFrame) -> None:
        number = self._number
        if frame.can_id == cia.NMT:
            self._command(frame.data)
        elif frame.can_id == cia.SDO_REQUEST + number and self.state is not NmtState.STOPPED:
            self._asked(frame.data)
        elif frame.can_id in (cia.RPDO1 + number, cia.RPDO2 + number) and self.state is NmtState.OPERATIONAL:
            self._take(frame.can_id - number, frame.data)
        elif cia.HEARTBEAT < frame.can_id < cia.HEARTBEAT + 0x80:
            self._heard(frame.can_id - cia.HEARTBEAT)

    def _asked(self, request: bytes) -> None:
        if self.abort_next and request[:1] != b"\x80":
            answer: bytes | None = sdo.abort(int.from_bytes(request[1:3], "little"), request[3], self.abort_next.pop(0))
        else:
            answer = self._sdo.answer(request)
        if answer is not None:
            reply = CanFrame(cia.SDO_REPLY + self._number, answer)
            if (late_s := self.late_next.pop(int.from_bytes(answer[1:3], "little"), None)) is not None:
                self._queue(late_s, lambda: self._out(reply))
            else:
                self._say(reply)

    def _say(self, frame: CanFrame) -> None:
        """An answer, late where the book says so, never before an earlier one."""
        late = self._faults.active(self._name, "late", self._loop.time())
        if late is not None or self._queued:
            self._queue(late.number if late is not None else 0.0, lambda: self._out(frame))
        else:
            self._out(frame)

    def _out(self, frame: CanFrame) -> None:
        if self._faults.active(self._name, "gone", self._loop.time()) is None:
            self._send(frame)

    # ------------------------------------------------------------ PDOs

    def _changed(self) -> None:
        """TPDO1 goes out with each change of what it carries."""
        if self.state is not NmtState.OPERATIONAL or self._hanging():
            return
        data = self._packed(cia.TPDO1)
        if data is not None and data != self._shown:
            self._shown = data
            self._say(CanFrame(cia.TPDO1 + self._number, data))

    def _cycle(self) -> None:
        """TPDO2 goes out by its event timer."""
        period_s = self._store[_PDOS[cia.TPDO2], 5][1] * 1e-3
        if self.state is NmtState.OPERATIONAL and period_s > 0.0:
            data = None if self._hanging() else self._packed(cia.TPDO2)
            if data is not None:
                self._say(CanFrame(cia.TPDO2 + self._number, data))
            self._again("cycle", period_s, self._cycle)

    def _hanging(self) -> bool:
        return self._faults.active(self._name, "hung", self._loop.time()) is not None

    def _layout(self, function: int) -> list[Entry] | None:
        """What the mapping says; None where the PDO is off or maps what does not exist."""
        index = _PDOS[function]
        if self._store[index, 1][1] & cia.PDO_OFF:
            return None
        words = [self._store[index + 0x200, place + 1][1] for place in range(self._store[index + 0x200, 0][1])]
        entries = [self.drive.entry(word >> 16, word >> 8 & 0xFF) for word in words]
        found = [entry for entry in entries if entry is not None]
        return found if len(found) == len(entries) else None

    def _packed(self, function: int) -> bytes | None:
        layout = self._layout(function)
        if layout is None:
            return None
        return cia.pack(layout, {entry: self.drive.read(entry) or 0 for entry in layout})

    def _take(self, function: int, data: bytes) -> None:
        layout = self._layout(function)
        if layout is None:
            return
        try:
            values = cia.unpack(layout, data)
        except Malformed:
            return
        for entry, value in reversed(values.items()):  # the mode before the controlword that starts something in it
            self.drive.write(entry, value)

    # ------------------------------------------------------------ objects

    def _defaults(self) -> dict[tuple[int, int], tuple[Entry, int]]:
        """The communication objects; a drive comes with its PDOs switched off."""
        known = {
            cia.DEVICE_TYPE: 0x00020192,
            cia.ERROR_REGISTER: 0,
            cia.CONSUMER_HEARTBEAT: 0,
            cia.PRODUCER_HEARTBEAT: 0,
            cia.VENDOR: cia.NO_VENDOR,
            cia.PRODUCT: 1,
            cia.REVISION: 1,
            cia.SERIAL: 1000 + self._number,
            cia.ERROR_BEHAVIOUR: 0,
        }
        for function, index in _PDOS.items():
            known[Entry(index, 1, "I", "COB-ID")] = cia.PDO_OFF | function + self._number
            known[Entry(index, 2, "B", "transmission type")] = cia.ON_CHANGE
            known[Entry(index, 5, "H", "event timer")] = 0
            known[Entry(index + 0x200, 0, "B", "mapped objects")] = 0
            known |= {Entry(index + 0x200, place, "I", "mapped object"): 0 for place in range(1, 9)}
        return {(entry.index, entry.sub): (entry, value) for entry, value in known.items()}

    def _value(self, entry: Entry) -> int:
        return self._store[entry.index, entry.sub][1]

    def _read(self, index: int, sub: int) -> bytes:
        if index in _TEXTS and sub == 0:
            return _TEXTS[index]
        if (index, sub) in self._store:
            entry, value = self._store[index, sub]
            return entry.encode(value)
        if (found := self.drive.entry(index, sub)) is not None and (read := self.drive.read(found)) is not None:
            return found.encode(read)
        raise sdo.SdoAbort(index, sub, sdo.NO_OBJECT)

    def _write(self, index: int, sub: int, data: bytes) -> None:
        stored = self._store.get((index, sub))
        entry = stored[0] if stored else self.drive.entry(index, sub)
        if entry is None:
            raise sdo.SdoAbort(index, sub, sdo.NO_OBJECT)
        try:
            value = entry.decode(data)
        except Malformed:
            raise sdo.SdoAbort(index, sub, sdo.LENGTH) from None
        if stored is None:
            if not self.drive.write(entry, value):
                raise sdo.SdoAbort(index, sub, sdo.READ_ONLY)
            return
        if index in (0x1000, 0x1001, 0x1018):
            raise sdo.SdoAbort(index, sub, sdo.READ_ONLY)
        self._store[index, sub] = (entry, value)
        if entry == cia.PRODUCER_HEARTBEAT:
            self._beat()

    # ------------------------------------------------------------ timers

    def _again(self, what: str, delay_s: float, act: Callable[[], None]) -> None:
        """One timer of each kind."""
        if what in self._handles:
            self._handles[what].cancel()
        self._handles[what] = self._loop.call_later(delay_s, act)

    def _queue(self, delay_s: float, act: Callable[[], None]) -> None:
        """Later, in the order in which they came: timers of the same instant fire in any order."""
        self._free_s = max(self._free_s, self._loop.time() + delay_s)
        self._queued.append(act)

        def run() -> None:
            self._timers.discard(handle)
            self._queued.popleft()()

        handle = self._loop.call_at(self._free_s, run)
        self._timers.add(handle)
