"""A Modbus server for simulators: over TCP, RTU over TCP, or RTU on a pseudo-terminal, with faults on its wire."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from hal.codec.modbus import (
    FrameError,
    Framing,
    Request,
    Unsupported,
    crc16,
    refusal,
    reply,
    take_request,
)

FaultKind = Literal[
    "silent", "half", "late", "late_half", "duplicate", "wrong_unit", "exception", "corrupt", "drop", "stale", "short"
]
Send = Callable[[bytes], None]


class Refusal(Exception):
    """What was asked is not done, for this reason."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class Silence(Exception):
    """No answer is given."""


@dataclass(slots=True)
class WireFault:
    """What happens to the next `times` answers, to requests of `function` only where one is given.

    `value`: seconds of delay, or the exception's code.

    ``exception`` keeps the request from the device; with all others the device has acted.
    """

    kind: FaultKind
    value: float = 0.0
    times: int = 1
    function: int | None = None


class Units(Protocol):
    """The devices behind a server, by unit number."""

    async def answer(self, request: Request) -> tuple[int, ...]:
        """Registers read, or nothing for a write. Raises Refusal, Silence."""
        ...


class ModbusServer:
    """Serves `units` on a free port of this machine, or on a pseudo-terminal."""

    def __init__(self, units: Units, framing: Framing = "tcp") -> None:
        self.framing: Framing = framing
        self.faults: list[WireFault] = []
        self.watch: Callable[[Request | Unsupported], None] = void
        """Told of every request."""
        self.port = 0
        self.port_path = ""
        self._units = units
        self._server: asyncio.Server | None = None
        self._writers: dict[asyncio.StreamWriter, asyncio.Task[None]] = {}
        self._pty: tuple[int, int, asyncio.Task[None]] | None = None
        self._last = b""

    async def start(self) -> None:
        """Listen; on the same port as before where there was one."""
        self._server = await asyncio.start_server(self._connected, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Pull the cable: nobody listens, connections are cut."""
        if self._server is not None:
            self._server.close()
            self._server = None
        self.drop()
        tasks = list(self._writers.values())
        if self._pty is not None:
            master, slave, task = self._pty
            self._pty = None
            asyncio.get_running_loop().remove_reader(master)
            tasks.append(task)
            os.close(master)
            os.close(slave)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def drop(self) -> None:
        """Cut every connection; the next ones are served."""
        for writer in self._writers:
            writer.transport.abort()

    async def start_pty(self) -> None:
        """Serve RTU on a pseudo-terminal; `port_path` is the client's end."""
        master, slave = os.openpty()
        tty.setraw(master)
        tty.setraw(slave)
        self.port_path = os.ttyname(slave)
        chunks: asyncio.Queue[bytes] = asyncio.Queue()
        asyncio.get_running_loop().add_reader(master, lambda: chunks.put_nowait(os.read(master, 1024)))
        task = asyncio.create_task(self._serve(chunks.get, lambda data: void(os.write(master, data))), name="pty")
        self._pty = (master, slave, task)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._writers[writer] = task
        try:
            await self._serve(lambda: reader.read(1024), writer.write)
        except (ConnectionError, asyncio.CancelledError):
            pass
        finally:
            del self._writers[writer]
            writer.transport.abort()

    async def _serve(self, receive: Callable[[], Awaitable[bytes]], send: Send) -> None:
        buffer = b""
        while data := await receive():
            buffer += data
            try:
                request, used = take_request(buffer, self.framing)
                while request is not None:
                    buffer = buffer[used:]
                    await self._answer(request, send)
                    request, used = take_request(buffer, self.framing)
            except FrameError:
                if self.framing == "tcp":
                    return
                buffer = b""

    async def _answer(self, request: Request | Unsupported, send: Send) -> None:
        self.watch(request)
        fault = self._next_fault(request.function)
        try:
            if isinstance(request, Unsupported):
                raise Refusal(request.code)
            if fault is not None and fault.kind == "exception":
                raise Refusal(round(fault.value))
            words = await self._units.answer(request)
        except Refusal as error:
            send(refusal(request, error.code, self.framing))
            return
        except Silence:
            return
        frame = reply(request, words, self.framing)
        last = self._last
        if fault is not None and fault.kind == "stale":
            send(last)
            return
        self._last = frame
        if fault is None:
            send(frame)
        elif fault.kind == "short":
            send(reply(request, words[:-1], self.framing))
        else:
            await self._spoilt(frame, fault, send)

    async def _spoilt(self, frame: bytes, fault: WireFault, send: Send) -> None:
        half = len(frame) // 2
        match fault.kind:
            case "half":
                send(frame[:half])
            case "late":
                await asyncio.sleep(fault.value)
                send(frame)
            case "late_half":
                send(frame[:half])
                await asyncio.sleep(fault.value)
                send(frame[half:])
            case "duplicate":
                send(frame + frame)
            case "wrong_unit":
                send(self._of_other_unit(frame))
            case "corrupt":
                send(frame[:-1] + bytes((frame[-1] ^ 0x5A,)))
            case "drop":
                raise ConnectionAbortedError
            case _:
                pass

    def _of_other_unit(self, frame: bytes) -> bytes:
        if self.framing == "tcp":
            return frame[:6] + bytes((frame[6] + 1,)) + frame[7:]
        body = bytes((frame[0] + 1,)) + frame[1:-2]
        return body + crc16(body).to_bytes(2, "little")

    def _next_fault(self, function: int) -> WireFault | None:
        self.faults = [fault for fault in self.faults if fault.times > 0]
        for fault in self.faults:
            if fault.function in (None, function):
                fault.times -= 1
                return fault
        return None


def void(_: object) -> None:
    """Nothing, whatever it is given."""
