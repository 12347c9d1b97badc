"""The network side of a simulated Open Protocol controller: TCP server, connections, and what goes wrong on the wire.

A client that is silent for 15 s is dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from hal.codec.open_protocol import Framer, Message, OpenProtocolError, encode
from hal.codec.open_protocol_messages import START
from hal.errors import NotConnected
from hal.fake.faults import FaultBook

SILENCE_S = 15.0
PIECE_S = 0.002


@dataclass(slots=True)
class WireFaults:
    """What the wire or the controller does wrong, changed at any time."""

    start_revision: int = 4
    """The highest revisions of MID 0001 and 0060 that are known."""
    result_revision: int = 2
    curves: bool = True
    piece: int = 0
    """Everything is sent in pieces of so many bytes, `PIECE_S` apart; 0: whole."""
    lose_results: int = 0
    """So many results are not told."""
    late_result_s: float = 0.0
    repeat_results: bool = False
    """Every result is told twice."""
    strange_identifier: str = ""
    """Before each tightening another one is stored and told under this identifier."""
    mute: set[int] = field(default_factory=set)
    """Requests that are carried out and not answered."""
    drop_at: set[int] = field(default_factory=set)
    """The connection is dropped once, right after one of these was carried out, before its answer."""
    unplugged: bool = False
    """Nothing passes in either direction; neither side is told."""


@dataclass(slots=True, eq=False)
class Client:
    """One connection."""

    writer: asyncio.StreamWriter
    started: bool = False
    subscribed: set[int] = field(default_factory=set)
    result_revision: int = 1
    curves: tuple[int, ...] = ()
    cut: bool = False
    """Something was lost on the way: the connection is of no more use."""
    free_s: float = 0.0
    """When the last piece of what was sent has left."""


class Server:
    """Serves the clients of one controller; `handle` returns the answers to one message."""

    def __init__(
        self,
        name: str,
        faults: FaultBook,
        wire: WireFaults,
        handle: Callable[[Client, Message], Awaitable[list[Message]]],
    ) -> None:
        self.clients: dict[Client, asyncio.Task[None]] = {}
        self._name = name
        self._faults = faults
        self._wire = wire
        self._handle = handle
        self._server: asyncio.Server | None = None
        self._end_gone: Callable[[], None] = lambda: None

    async def start(self, host: str, port: int) -> int:
        """Listen; returns the port."""
        self._server = await asyncio.start_server(self._accept, host, port)
        self._end_gone = self._faults.when(self._name, "gone", self.drop)
        return int(self._server.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Stop listening and drop every client."""
        self._end_gone()
        if self._server is None:
            return
        self._server.close()
        tasks = list(self.clients.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._server.wait_closed()

    def drop(self) -> None:
        """Drop every connection."""
        for client in self.clients:
            client.writer.transport.abort()

    def send(self, client: Client, message: Message) -> None:
        """Send, as well as the wire lets it."""
        client.cut = client.cut or self._wire.unplugged
        if client.cut or client.writer.is_closing():
            return
        raw, loop = encode(message), asyncio.get_running_loop()
        if not self._wire.piece and client.free_s <= loop.time():
            client.writer.write(raw)
            return
        piece = self._wire.piece or len(raw)
        for at in range(0, len(raw), piece):
            client.free_s = max(client.free_s, loop.time()) + PIECE_S
            loop.call_at(client.free_s, client.writer.write, raw[at : at + piece])

    def push(self, subject: int, message: Message) -> None:
        """Send to whom has subscribed `subject`."""
        for client in self.clients:
            if client.started and subject in client.subscribed:
                self.send(client, message)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = Client(writer)
        self.clients[client] = asyncio.create_task(self._serve(client, reader), name=f"{self._name} client")

    async def _serve(self, client: Client, reader: asyncio.StreamReader) -> None:
        try:
            await self._listen(client, reader)
        except (OSError, TimeoutError, NotConnected, OpenProtocolError):
            pass
        finally:
            del self.clients[client]
            client.writer.transport.abort()
            with contextlib.suppress(OSError):
                await client.writer.wait_closed()

    async def _listen(self, client: Client, reader: asyncio.StreamReader) -> None:
        framer, loop = Framer(), asyncio.get_running_loop()
        heard_s = loop.time()
        while True:
            async with asyncio.timeout_at(heard_s + SILENCE_S):
                received = await reader.read(65536)
                client.cut = client.cut or self._wire.unplugged
                if client.cut and not received:
                    await asyncio.Event().wait()  # it is not told that the other side has gone
            if not received:
                return
            if not client.cut:
                heard_s = loop.time()
                for message in framer.feed(received):
                    await self._take(client, message)

    async def _take(self, client: Client, message: Message) -> None:
        await self._faults.gate(self._name, str(message), deadline_s=math.inf)
        if not client.started and message.mid != START:
            return
        answers = await self._handle(client, message)
        if message.mid in self._wire.drop_at:
            self._wire.drop_at.discard(message.mid)
            client.writer.transport.abort()
        elif message.mid not in self._wire.mute:
            for answer in answers:
                self.send(client, answer)
