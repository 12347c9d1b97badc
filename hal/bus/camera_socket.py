"""A camera on a TCP connection, for simulators: both sides. See `hal.bus.camera`.

It has what a GenTL camera has: user sets, a software trigger, buffers with parts, the nodes of the 3D space. A request
is a line of JSON, ``{"do": "shoot", "user_set": "rotor"}``; so is its answer, whose parts follow it as little-endian
float32::

    {"ok": true, "number": 5, "age_s": 0.4, "unit": "Millimeter", "invalid": 0.0, "bytes": 960000,
     "parts": [["Coord3D_ABC32f", 400, 200]]}
    {"ok": false, "error": "refused", "reason": "..."}             error: refused, fault
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from hal.bus.camera import CameraError, CameraLost, CameraRefused, Shot, Who
from hal.codec import coord3d

CONNECT_S = 2.0
Answer = tuple[dict[str, Any], bytes]
Serve = Callable[[dict[str, Any]], Awaitable[Answer]]


class SocketCamera:
    """The host's side. Blocking, as a producer is; it waits for an answer as long as it takes."""

    def __init__(self, address: str) -> None:
        where = urlsplit(address)
        try:
            self._socket = socket.create_connection((where.hostname or "", where.port or 0), CONNECT_S)
        except OSError as error:
            raise CameraLost(f"no camera at {address}: {error}") from None
        self._socket.settimeout(None)
        self._stream = self._socket.makefile("rwb")

    def who(self) -> Who:
        """See `hal.bus.camera.Camera.who`."""
        said, _ = self._ask("who")
        return Who(said["vendor"], said["model"], said["serial"], said["firmware"])

    def lit(self) -> bool:
        """See `hal.bus.camera.Camera.lit`."""
        return bool(self._ask("lit")[0]["lit"])

    def shoot(self, user_set: str) -> None:
        """See `hal.bus.camera.Camera.shoot`."""
        self._ask("shoot", user_set=user_set)

    def fetch(self, timeout_s: float) -> Shot | None:
        """See `hal.bus.camera.Camera.fetch`."""
        said, data = self._ask("fetch", timeout_s=timeout_s)
        if said["number"] is None:
            return None
        invalid = said["invalid"]
        a = b = coord3d.Coordinate()
        space = coord3d.Space(said["unit"], coordinates=(a, b, coord3d.Coordinate(invalid=invalid)))
        return Shot(said["number"], coord3d.cloud(_parts(said["parts"], data), space), said["age_s"])

    def stop(self) -> bool:
        """See `hal.bus.camera.Camera.stop`."""
        return bool(self._ask("stop")[0]["lit"])

    def close(self) -> None:
        """Hang up."""
        with contextlib.suppress(OSError):
            self._stream.close()
        self._socket.close()

    def _ask(self, what: str, **more: object) -> Answer:
        try:
            self._stream.write(json.dumps({"do": what, **more}).encode() + b"\n")
            self._stream.flush()
            line = self._stream.readline()
            if not line:
                raise CameraLost("the camera has hung up")
            said = json.loads(line)
            data = self._stream.read(said.get("bytes", 0))
        except (OSError, ValueError) as error:
            raise CameraLost(f"the link to the camera broke: {error}") from None
        if not said["ok"]:
            raise (CameraRefused if said["error"] == "refused" else CameraError)(said["reason"])
        return said, data


def _parts(layout: list[tuple[str, int, int]], data: bytes) -> list[coord3d.Part]:
    """Parts that share `data` in order; the last ones are short where it is."""
    values: NDArray[np.float32] = np.frombuffer(data[: len(data) // 4 * 4], "<f4")
    parts = []
    for name, width, height in layout:
        size = width * height * (3 if "ABC" in name else 1)
        parts.append(coord3d.Part(name, width, height, values[:size]))
        values = values[size:]
    return parts


class CameraServer:
    """The camera's side: one request after the other of each connection goes to `serve`, until it is closed."""

    def __init__(self, serve: Serve) -> None:
        self.port = 0
        self._serve = serve
        self._server: asyncio.Server | None = None
        self._writers: dict[asyncio.StreamWriter, asyncio.Task[None]] = {}

    async def start(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Listen; port 0 takes a free one, and the same one again after `close`."""
        self._server = await asyncio.start_server(self._connected, host, port or self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Pull the cable: nobody listens, connections are cut."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        tasks = list(self._writers.values())
        for writer in self._writers:
            writer.transport.abort()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._writers[writer] = task
        try:
            while line := await reader.readline():
                request = json.loads(line)
                if not isinstance(request, dict):
                    break
                said, data = await self._serve(request)
                writer.write(json.dumps(said | {"bytes": len(data)}).encode() + b"\n" + data)
                await writer.drain()
        except (OSError, ValueError, asyncio.CancelledError):  # the link broke, or what came is no request
            pass
        finally:
            del self._writers[writer]
            writer.transport.abort()
