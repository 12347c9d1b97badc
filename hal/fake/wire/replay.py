"""A recorded conversation with a device, played back by a peer that answers as recorded.

The peer says what came from the device then, with the pauses of then, and waits wherever the controller spoke. What the
controller says now is compared with what it said then, byte by byte; at the first difference the peer falls silent and
says where in the file it is. On CAN each node has its own thread of the conversation, since nodes do not wait for each
other; heartbeats of the controller are left out, since they follow its clock and nothing else.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path

from hal.bus.hub import CanHub
from hal.bus.pty import Pty
from hal.capture import Record
from hal.codec.cia301 import NMT, SYNC
from hal.codec.lawicel import CanFrame, encode


class Replay:
    """One thread of a conversation. `difference` is empty while the controller says what it said then."""

    def __init__(self, records: Iterable[Record], send: Callable[[Record], None]) -> None:
        self.records = tuple(record for record in records if not record.event)
        self.difference = ""
        self.done = asyncio.Event()
        """Everything was said, or something else than then."""
        self._send = send
        self._came = b""
        self._spoken = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to speak."""
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._play(), name="replay")

    async def close(self) -> None:
        """Leaves no task."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    def heard(self, data: bytes) -> None:
        """What the controller says now."""
        self._came += data
        if self.done.is_set() and not self.difference:
            self.difference = f"beyond the end of the recording the controller says {self._came!r}"
        self._spoken.set()

    async def _play(self) -> None:
        before_s = self.records[0].time_s if self.records else 0.0
        for record in self.records:
            if record.direction == "in":
                await asyncio.sleep(record.time_s - before_s)
                self._send(record)
            elif not await self._same(record):
                break
            before_s = record.time_s
        self.done.set()
        if self._came and not self.difference:
            self.heard(b"")

    async def _same(self, record: Record) -> bool:
        """Wait for what `record` has, in however many pieces; false where something else comes."""
        wanted = spoken(record)
        while True:
            alike = _alike(wanted, self._came)
            if alike == len(wanted):
                self._came = self._came[alike:]
                return True
            if alike < len(self._came):
                at = f"line {record.line} (t = {record.time_s:g} s), byte {alike}"
                self.difference = f"{at}: recorded {wanted!r}, the controller says {self._came!r}"
                return False
            self._spoken.clear()
            await self._spoken.wait()


def spoken(record: Record) -> bytes:
    """The bytes of a record; a CAN frame as the line that an adapter makes of it."""
    return record.data if record.can_id is None else encode(CanFrame(record.can_id, record.data))


def _alike(wanted: bytes, came: bytes) -> int:
    """How many bytes are the same from the beginning on."""
    both = min(len(wanted), len(came))
    return next((i for i in range(both) if wanted[i] != came[i]), both)


# ------------------------------------------------------------ peers, by kind of wire


@contextlib.asynccontextmanager
async def on_tcp(records: Iterable[Record]) -> AsyncIterator[tuple[Replay, int]]:
    """Listens on the port that is given with the replay; each connection goes on where the one before ended."""
    writers: list[asyncio.StreamWriter] = []
    replay = Replay(records, lambda record: writers[-1].write(record.data))
    tasks: set[asyncio.Task[None]] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        writers.append(writer)
        replay.start()
        with contextlib.suppress(OSError, asyncio.CancelledError):
            while data := await reader.read(65536):
                replay.heard(data)
        tasks.discard(task)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield replay, server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in writers:
            writer.transport.abort()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await replay.close()


@contextlib.asynccontextmanager
async def on_serial(records: Iterable[Record], path: Path) -> AsyncIterator[Replay]:
    """A pseudo-terminal at `path`."""

    def heard(data: bytes) -> None:
        replay.start()
        replay.heard(data)

    pty = Pty(path, heard)
    replay = Replay(records, lambda record: pty.write(record.data))
    pty.plug()
    try:
        yield replay
    finally:
        pty.unplug()
        await replay.close()


@contextlib.asynccontextmanager
async def on_can(records: Iterable[Record], hub: CanHub, *, controller: int = 127) -> AsyncIterator[dict[int, Replay]]:
    """The recorded nodes, on `hub`, each with its replay; each begins when the controller first speaks to it."""
    threads: dict[int, list[Record]] = {}
    for record in records:
        if record.can_id is not None and (node := _node(record.can_id, record.data)) != controller:
            threads.setdefault(node, []).append(record)

    def heard(frame: CanFrame) -> None:
        if (replay := replays.get(_node(frame.can_id, frame.data))) is not None:
            replay.start()
            replay.heard(encode(frame))

    send, leave = hub.attach(heard)
    replays = {
        node: Replay(_from_first_word(thread), lambda record: send(CanFrame(record.can_id or 0, record.data)))
        for node, thread in threads.items()
        if node
    }
    try:
        yield replays
    finally:
        leave()
        for replay in replays.values():
            await replay.close()


def _node(can_id: int, data: bytes) -> int:
    """Whom a frame concerns: the node of its identifier, or whom NMT commands. 0: all, as SYNC does."""
    if can_id == NMT:
        return data[1] if len(data) > 1 else 0
    return 0 if can_id == SYNC else can_id & 0x7F


def _from_first_word(thread: list[Record]) -> list[Record]:
    """Without what the node said to nobody before it was spoken to."""
    first = next((i for i, record in enumerate(thread) if record.direction == "out"), 0)
    return thread[first:]
