"""The guard's end of its socket: one controller at a time; a second one is sent away."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from pathlib import Path

from hal.codec.guard import GuardMessageError, Kind, split

_log = logging.getLogger(__name__)
FULL = 1 << 20
"""Bytes that may wait for a controller that does not read; one with more is sent away."""


class Server:
    """`on_message` may raise GuardMessageError, KeyError, TypeError or ValueError: the controller is then sent away."""

    def __init__(
        self,
        path: Path,
        on_came: Callable[[], None],
        on_left: Callable[[], None],
        on_message: Callable[[Kind, bytes], None],
    ) -> None:
        self._path = path
        self._on_came, self._on_left, self._on_message = on_came, on_left, on_message
        self._server: asyncio.AbstractServer | None = None
        self.controller: asyncio.Transport | None = None

    async def start(self) -> None:
        """Listen, for this user only. Raises OSError."""
        self._path.unlink(missing_ok=True)
        self._server = await asyncio.get_running_loop().create_unix_server(lambda: _Connection(self), str(self._path))
        self._path.chmod(0o600)

    async def close(self) -> None:
        """The controller is sent away, nobody comes any more."""
        if self.controller is not None:
            self.controller.abort()
            self.controller = None
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()
            self._path.unlink(missing_ok=True)

    def send(self, message: bytes) -> None:
        """To the controller, if there is one."""
        if self.controller is not None:
            self.controller.write(message)
            if self.controller.get_write_buffer_size() > FULL:
                self.controller.abort()

    def came(self, transport: asyncio.Transport) -> bool:
        """Whether the one who came may stay."""
        if self.controller is not None:
            _log.warning("a second controller was sent away")
            return False
        self.controller = transport
        self._on_came()
        return True

    def left(self, transport: asyncio.Transport | None) -> None:
        """Somebody has gone."""
        if transport is self.controller and transport is not None:
            self.controller = None
            self._on_left()

    def message(self, kind: Kind, body: bytes) -> None:
        """From the controller."""
        self._on_message(kind, body)


class _Connection(asyncio.Protocol):
    def __init__(self, server: Server) -> None:
        self._server = server
        self._transport: asyncio.Transport | None = None
        self._rest = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if not self._server.came(transport):
            transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._server.controller is not self._transport:
            return
        try:
            messages, self._rest = split(self._rest + data)
            for kind, body in messages:
                self._server.message(kind, body)
        except (GuardMessageError, KeyError, TypeError, ValueError) as error:
            _log.error("a controller that speaks something else was sent away: %s", error)
            assert self._transport is not None
            self._transport.abort()

    def connection_lost(self, error: Exception | None) -> None:
        self._server.left(self._transport)
