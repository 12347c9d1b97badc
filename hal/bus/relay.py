"""Between a controller and a device: what either says is told and passed on, byte by byte, never changed.

A relay adds its own delay: the bytes go through this process once more.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Protocol

from hal.bus.pty import Pty
from hal.bus.serial import SerialLine

LINGER_S = 0.2
"""For last words to pass."""


class Told(Protocol):
    """Who hears what passes: `out` goes to the device; `link` counts the connections."""

    def out(self, link: int, data: bytes) -> None: ...
    def came(self, link: int, data: bytes) -> None: ...
    def event(self, link: int, what: str) -> None: ...


class TcpRelay:
    """Listens on this machine, and for each connection opens one to the device at `host`:`port`."""

    def __init__(self, host: str, port: int, told: Told) -> None:
        self._host = host
        self._port = port
        self._told = told
        self._links = 0
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self, port: int = 0) -> int:
        """Listen; port 0 takes a free one. Returns the port. Raises OSError."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", port)
        return int(self._server.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Cut every connection that does not end by itself; leaves no task."""
        if self._server is not None:
            self._server.close()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=LINGER_S)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        self._links += 1
        link = self._links
        why = "closed"
        try:
            why = await self._relayed(link, reader, writer)
        except OSError as error:
            why = f"lost: {error}"
        except asyncio.CancelledError:
            pass
        finally:
            self._told.event(link, why)
            self._tasks.discard(task)
            await _closed(writer)

    async def _relayed(self, link: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> str:
        device_reader, device_writer = await asyncio.open_connection(self._host, self._port)
        self._told.event(link, "opened")

        async def outward() -> str:
            while data := await reader.read(65536):
                self._told.out(link, data)
                device_writer.write(data)
                await device_writer.drain()
            return "closed by the controller"

        async def inward() -> str:
            while data := await device_reader.read(65536):
                self._told.came(link, data)
                writer.write(data)
                await writer.drain()
            return "closed by the device"

        ways = [asyncio.create_task(way()) for way in (outward, inward)]
        try:
            done, _ = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            return next(iter(done)).result()
        finally:
            for task in ways:
                task.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            await asyncio.gather(*(_closed(end) for end in (device_writer, writer)))


async def _closed(end: asyncio.StreamWriter) -> None:
    """Close behind what was written, or cut."""
    end.close()
    try:
        async with asyncio.timeout(LINGER_S):
            await end.wait_closed()
    except (OSError, TimeoutError):
        end.transport.abort()


class SerialRelay:
    """The device's port is open here; the controller opens the pseudo-terminal at `path` instead."""

    def __init__(self, port: str, baud: int, parity: str, path: Path, told: Told) -> None:
        self._told = told
        self._pty = Pty(path, self._out)
        self._opened = (port, baud, parity)
        self._line: SerialLine | None = None

    def start(self) -> None:
        """Raises OSError where the device's port cannot be opened or is in use."""
        port, baud, parity = self._opened
        self._line = SerialLine(port, baud, self._came, self._lost, parity=parity)
        self._pty.plug()
        self._told.event(1, "opened")

    def close(self) -> None:
        """Give both ends back."""
        self._pty.unplug()
        if self._line is not None:
            self._line.close()

    def _out(self, data: bytes) -> None:
        self._told.out(1, data)
        if self._line is not None and self._line.is_open:
            try:
                self._line.write(data)
            except OSError as error:
                self._told.event(1, f"not passed on: {error}")

    def _came(self, data: bytes) -> None:
        self._told.came(1, data)
        self._pty.write(data)

    def _lost(self, reason: str) -> None:
        self._told.event(1, f"lost: {reason}")
        self._pty.unplug()
