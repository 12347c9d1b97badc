"""A CAN bus over TCP: each connection is an adapter that speaks LAWICEL lines, each attached port a node in-process.

For tests and for a cell on a desk, where no CAN interface is. It is also the place to make a bus fail: frames lost,
doubled, delayed or cut in half, an adapter unplugged or in bus-off.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from hal.codec.lawicel import BEL, CR, CanFrame, LawicelError, decode, encode, split

Deliver = Callable[[CanFrame], None]
Match = Callable[[CanFrame], bool]
Kind = Literal["lost", "twice", "late", "half"]


@dataclass(slots=True)
class BusFault:
    """What happens to the next `count` frames that `match`. A late one holds up what its sender says after it."""

    kind: Kind
    match: Match
    count: int = 1
    delay_s: float = 0.0


@dataclass(slots=True, eq=False)
class _Adapter:
    """One TCP connection. An adapter in bus-off neither sends nor hears until it is opened anew."""

    writer: asyncio.StreamWriter
    opened: bool = False
    bus_off: bool = False
    rest: bytes = field(default=b"")


class CanHub:
    """`port` is known after `start`."""

    def __init__(self) -> None:
        self.faults: list[BusFault] = []
        self.log: list[CanFrame] | None = None
        """Where it is a list, every frame on the bus is appended."""
        self.port = 0
        self._server: asyncio.Server | None = None
        self._adapters: set[_Adapter] = set()
        self._ports: list[Deliver] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._timers: set[asyncio.TimerHandle] = set()
        self._held: dict[object, deque[CanFrame]] = {}

    async def start(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Listen; port 0 takes a free one, and the same one again after `unplug`."""
        self._server = await asyncio.start_server(self._serve, host, port or self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Drop every adapter; leaves no task."""
        await self.unplug()
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        self._held.clear()

    async def unplug(self) -> None:
        """Every adapter is gone and none can be opened; `start` plugs it in again."""
        if self._server is not None:
            self._server.close()
        for adapter in tuple(self._adapters):
            adapter.writer.transport.abort()
        if self._tasks:
            await asyncio.wait(self._tasks)
        if self._server is not None:
            await self._server.wait_closed()
        self._server = None

    def bus_off(self) -> None:
        """Every adapter goes bus-off; each stays so until it is closed and opened."""
        for adapter in self._adapters:
            adapter.bus_off = True

    def attach(self, deliver: Deliver) -> tuple[Deliver, Callable[[], None]]:
        """A node in this process: `deliver` gets every frame of others. Returns its send, and what ends it."""
        self._ports.append(deliver)
        return lambda frame: self._carry(frame, deliver), lambda: self._ports.remove(deliver)

    # ------------------------------------------------------------ adapters

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        adapter = _Adapter(writer)
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        self._adapters.add(adapter)
        try:
            while data := await reader.read(4096):
                lines, adapter.rest = split(adapter.rest + data)
                for line in lines:
                    self._line(adapter, line)
        except OSError:
            pass
        finally:
            self._adapters.discard(adapter)
            self._tasks.discard(task)
            writer.close()

    def _line(self, adapter: _Adapter, line: bytes) -> None:
        match line[:1]:
            case b"":
                answer = CR
            case b"O" | b"L":
                adapter.opened, adapter.bus_off, answer = True, False, CR
            case b"C":
                adapter.opened, adapter.bus_off, answer = False, False, CR
            case b"S" | b"s":
                answer = BEL if adapter.opened else CR
            case b"V" | b"v":
                answer = b"V1010" + CR
            case b"N":
                answer = b"N0001" + CR
            case b"F":
                answer = (b"F80" if adapter.bus_off else b"F00") + CR
            case _:
                try:
                    frame = decode(line)
                except LawicelError:
                    answer = BEL
                else:
                    answer = b"z" + CR
                    if adapter.opened and not adapter.bus_off:
                        self._carry(frame, adapter)
        self._write(adapter, answer)

    # ------------------------------------------------------------ the bus

    def _carry(self, frame: CanFrame, source: object) -> None:
        if self.log is not None:
            self.log.append(frame)
        if self._held.get(source):
            self._later(frame, source, 0.0)
            return
        fault = next((one for one in self.faults if one.count > 0 and one.match(frame)), None)
        if fault is None:
            self._spread(frame, source)
            return
        fault.count -= 1
        match fault.kind:
            case "lost":
                return
            case "twice":
                self._spread(frame, source)
                self._spread(frame, source)
            case "half":
                self._halve(frame, source)
            case "late":
                self._later(frame, source, fault.delay_s)

    def _spread(self, frame: CanFrame, source: object) -> None:
        line = encode(frame)
        for adapter in self._adapters:
            if adapter is not source and adapter.opened and not adapter.bus_off:
                self._write(adapter, line)
        for deliver in tuple(self._ports):
            if deliver is not source:
                deliver(frame)

    def _halve(self, frame: CanFrame, source: object) -> None:
        """Only lines can be cut: nodes hear nothing of it."""
        line = encode(frame)
        for adapter in self._adapters:
            if adapter is not source:
                self._write(adapter, line[: len(line) // 2] + CR)

    def _later(self, frame: CanFrame, source: object, delay_s: float) -> None:
        """The first of a queue has the timer; those behind it follow at once."""
        queue = self._held.setdefault(source, deque())
        queue.append(frame)
        if len(queue) > 1:
            return

        def deliver() -> None:
            self._timers.discard(timer)
            waiting = self._held.pop(source)
            for one in waiting:
                self._spread(one, source)

        timer = asyncio.get_running_loop().call_later(delay_s, deliver)
        self._timers.add(timer)

    @staticmethod
    def _write(adapter: _Adapter, data: bytes) -> None:
        if not adapter.writer.is_closing():
            with contextlib.suppress(OSError):
                adapter.writer.write(data)
