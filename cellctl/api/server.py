"""uvicorn inside a loop that somebody else owns: bounded headers, no signals taken, time limits of the wall."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Iterator
from typing import Any

import h11
import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_LIMIT_S = 10.0
KEEP_ALIVE_S = 5.0
SHUTDOWN_LIMIT_S = 5.0
"""Seconds of the wall."""


class _DeadlineProtocol(H11Protocol):
    """Hangs up on a client that opens a connection and does not finish its headers."""

    header_limit_s = HEADER_LIMIT_S

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._deadline: asyncio.TimerHandle | None = None
        self._watch()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        self._unwatch()
        super().connection_lost(exc)

    def _watch(self) -> None:
        if self.conn.their_state is not h11.IDLE:
            self._unwatch()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(self.header_limit_s, self._late)

    def _unwatch(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _late(self) -> None:
        self._deadline = None
        if self.conn.their_state is h11.IDLE and not self.transport.is_closing():
            self.transport.close()


class Server(uvicorn.Server):
    """One server; `stop` ends it, signals are the caller's."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.listening = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; `listening` is set from then on."""
        await super().startup(sockets)
        self.listening.set()

    async def serve_on(self, sock: socket.socket) -> None:
        """Serve on a socket that is bound already, so that a port in use is an error of the caller's own."""
        await self.serve(sockets=[sock])

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals stay with who owns the process."""
        yield

    def stop(self) -> None:
        """Take no more requests and end."""
        self.should_exit = True

    @property
    def port(self) -> int:
        """The port that is listened on, once started."""
        address: tuple[Any, ...] = self.servers[0].sockets[0].getsockname()
        return int(address[1])


def bound(host: str, port: int) -> socket.socket:
    """A socket bound to that address. Raises OSError where it is taken."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # With the protocol named, asyncio turns off Nagle's algorithm on what connects: an answer is two writes, and the
    # second would wait for the client to acknowledge the first, which takes it 40 ms.
    sock = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
    except OSError:
        sock.close()
        raise
    return sock


def make_server(app: FastAPI, *, wall_s: float) -> Server:
    """A server for `app`. `wall_s` is how many seconds of the loop's time one second of the wall lasts."""
    protocol = type("DeadlineProtocol", (_DeadlineProtocol,), {"header_limit_s": HEADER_LIMIT_S * wall_s})
    config = uvicorn.Config(
        app,
        http=protocol,
        ws="none",
        lifespan="off",
        log_level=logging.WARNING,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_keep_alive=max(1, round(KEEP_ALIVE_S * wall_s)),
        timeout_graceful_shutdown=max(1, round(SHUTDOWN_LIMIT_S * wall_s)),
        limit_concurrency=200,
        backlog=128,
    )
    return Server(config)
