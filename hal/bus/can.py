"""One CAN adapter: python-can behind asyncio. The only importer of python-can.

One monitor task per bus owns connect, poll and recover. It holds no thread of the library: python-can's notifier dies
silently with the adapter. Every identifier that is watched has a receive deadline; a bus on which nothing at all is
heard any longer is opened anew, which is also how an adapter leaves bus-off. Nothing is sent twice and nothing that
could not be sent is kept.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import select
import socket
from collections.abc import Callable, Mapping
from typing import Any

import can

from hal.bus.ears import Ears, Listener
from hal.clock import standing_still
from hal.codec.cia301 import heartbeat
from hal.codec.lawicel import CanFrame, LawicelError, decode, encode, split
from hal.errors import NotConnected

_log = logging.getLogger(__name__)

SEND_TIMEOUT_S = 0.2
"""An adapter whose buffer stays full for so long is not sending. pyserial also takes a write that is done, but later
than this on a busy machine, for failed; with 0 it would turn in circles on a full buffer. So a socket is written to
without it."""
OPEN_S = 4.0
"""An adapter must be open by then."""
RETRY_S = 0.5
"""Between two attempts to open it."""
SILENCE_S = 2.5
"""A bus with watched identifiers on which nothing is heard for so long is opened anew."""
TICK_S = 0.05
"""Between two looks at the receive deadlines."""
BATCH = 1000
"""Frames in one go."""
READ = 65536
FRAMES = (b"t", b"T", b"r", b"R")
"""How lines begin that carry one."""
BUS_OFF = 0x40
"""Bit of a socketcan error frame's identifier."""
_LIBRARY = (can.CanError, OSError)


class CanBus:
    """The adapter described by `options` (python-can's own: interface, channel, bitrate, ...), shared by its nodes.

    `node` is the controller's number, whose heartbeat `beat` sends: the caller's own cycle calls it, so that drives
    stop when that cycle hangs.
    """

    def __init__(self, options: Mapping[str, Any], *, node: int = 127, name: str = "can") -> None:
        self.name = name
        self._options = dict(options)
        self.node = node
        self._adapter: can.BusABC | None = None
        self._monitor: asyncio.Task[None] | None = None
        self._users = 0
        self._turn = asyncio.Lock()
        self._opened = asyncio.Event()
        self._closing = asyncio.Event()
        self._wake = asyncio.Event()
        self._trouble = "not opened"
        self.ears = Ears()
        self._peer: socket.socket | None = None
        self._rest = b""
        self.corrupt = 0
        """Lines or frames that could not be read."""

    @property
    def trouble(self) -> str:
        """Why nothing can be sent; empty while the adapter is open."""
        return "" if self._adapter is not None else self._trouble or "closed"

    # ------------------------------------------------------------ life

    async def open(self) -> None:
        """One more user; returns once the adapter is open. Raises NotConnected with the library's reason."""
        self._users += 1
        try:
            async with asyncio.timeout(OPEN_S):
                async with self._turn:
                    await self._ended()
                    if self._monitor is None:
                        self._monitor = asyncio.create_task(self._run(), name=f"{self.name} monitor")
                await self._opened.wait()
        except BaseException as error:
            await self.release()
            if isinstance(error, TimeoutError):
                raise NotConnected(f"the CAN adapter cannot be opened: {self._trouble}", device=self.name) from None
            raise

    async def release(self) -> None:
        """One user less; the last one closes the adapter. Never raises."""
        self._users -= 1
        async with self._turn:
            if self._users == 0 and self._monitor is not None:
                self._closing.set()
                self._wake.set()
                await self._ended()

    async def _ended(self) -> None:
        """Until a monitor that is to end has ended; one that is not goes on."""
        if self._monitor is not None and self._closing.is_set():
            await asyncio.wait({self._monitor})
            self._monitor = None
        self._closing.clear()

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        while not self._closing.is_set():
            try:
                with standing_still():
                    adapter = await loop.run_in_executor(None, self._make)
            except Exception as error:  # whatever the library raises: the adapter is not there
                self._trouble = str(error)
                await self._pause(RETRY_S)
                continue
            try:
                await self._poll(adapter)
            finally:
                self._lose()
                with standing_still():
                    await loop.run_in_executor(None, _shut, adapter)
            if not self._closing.is_set():
                _log.warning("%s: %s", self.name, self._trouble)
                await self._pause(RETRY_S)

    def _make(self) -> can.BusABC:
        adapter = can.Bus(ignore_config=True, **self._options)
        if (peer := _peer(adapter)) is not None:
            # Or a frame waits, up to 40 ms, for the acknowledgement of the one before.
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setblocking(False)
        return adapter

    async def _pause(self, seconds: float) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._closing.wait()

    async def _poll(self, adapter: can.BusABC) -> None:
        """Stay until the adapter fails or the bus is closed."""
        loop = asyncio.get_running_loop()
        self._rest, self._peer = b"", _peer(adapter)
        self._trouble, self._adapter, self.ears.heard_s = "", adapter, loop.time()
        self._wake.clear()
        file = _descriptor(adapter)
        if file is not None:
            loop.add_reader(file, *((self._drain, adapter, file) if self._peer is None else (self._lines, self._peer)))
        self._opened.set()
        try:
            while not self._closing.is_set() and not self._trouble:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(TICK_S if file is not None else 0.001):
                        await self._wake.wait()
                if file is None:
                    self._drain(adapter, None)
                self._look(loop.time())
        finally:
            if file is not None:
                loop.remove_reader(file)

    def _lose(self) -> None:
        self._adapter = self._peer = None
        self._opened.clear()
        self.ears.down(self._trouble or "closed")

    # ------------------------------------------------------------ frames

    def send(self, frame: CanFrame) -> None:
        """Hand one frame to the adapter. Raises NotConnected; the frame is then lost."""
        if self._adapter is None:
            raise NotConnected(f"no CAN adapter: {self._trouble or 'closed'}", device=self.name)
        try:
            if self._peer is None:
                self._adapter.send(_message(frame), timeout=SEND_TIMEOUT_S)
            elif self._peer.send(line := encode(frame)) < len(line):
                raise OSError("the socket is full")
        except _LIBRARY as error:
            self._fail(f"send failed: {error}")
            raise NotConnected(self._trouble, device=self.name) from error

    def beat(self) -> None:
        """The controller's heartbeat; without an adapter nothing is sent, and the drives act on that."""
        with contextlib.suppress(NotConnected):
            self.send(heartbeat(self.node))

    def subscribe(self, can_id: int, listener: Listener) -> Callable[[], None]:
        """Hand frames with `can_id` to `listener`; returns what ends that."""
        return self.ears.subscribe(can_id, listener)

    def watch(self, can_id: int, within_s: float, lost: Callable[[], None]) -> Callable[[], None]:
        """Call `lost` once whenever `can_id`, heard before, is not heard within `within_s`; returns what ends that."""
        return self.ears.watch(can_id, within_s, lost, asyncio.get_running_loop().time())

    def _drain(self, adapter: can.BusABC, file: int | None) -> None:
        """Whatever the adapter holds, without waiting."""
        for _ in range(BATCH):
            try:
                message = adapter.recv(timeout=0)
            except (ValueError, IndexError):  # half a line, or garbage in one: slcan takes it for a frame
                self.corrupt += 1
                continue
            except _LIBRARY as error:
                self._fail(f"receive failed: {error}")
                return
            if message is not None:
                self._take(message)
            elif file is None or not select.select([file], [], [], 0)[0]:
                return

    def _lines(self, peer: socket.socket) -> None:
        """The same of an slcan adapter behind a socket, which the library would read byte by byte."""
        try:
            data = peer.recv(READ)
        except BlockingIOError:
            return
        except OSError as error:
            self._fail(f"receive failed: {error}")
            return
        if not data:
            self._fail("receive failed: socket disconnected")
            return
        lines, self._rest = split(self._rest + data)
        for line in lines:
            if line[:1] in FRAMES:
                try:
                    self.ears.heard(decode(line), asyncio.get_running_loop().time())
                except LawicelError:
                    self.corrupt += 1

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame:
            if message.arbitration_id & BUS_OFF:
                self._fail("bus-off")
            return
        if len(message.data) != (0 if message.is_remote_frame else message.dlc):
            self.corrupt += 1  # a line that was cut short
            return
        frame = CanFrame(message.arbitration_id, bytes(message.data), message.is_extended_id, message.is_remote_frame)
        self.ears.heard(frame, asyncio.get_running_loop().time())

    def _look(self, now: float) -> None:
        self.ears.look(now)
        if self.ears.watching and now - self.ears.heard_s > SILENCE_S:
            self._fail(f"nothing heard for {SILENCE_S:g} s")

    def _fail(self, reason: str) -> None:
        self._trouble = self._trouble or reason
        self._wake.set()


def _message(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.can_id,
        data=frame.data,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
    )


def _descriptor(adapter: can.BusABC) -> int | None:
    """What can be waited for; None where the adapter has to be polled."""
    try:
        file = adapter.fileno()
    except (NotImplementedError, can.CanError):
        return None
    return file if file >= 0 else None


def _peer(adapter: can.BusABC) -> socket.socket | None:
    """The socket of an slcan adapter behind `socket://`, else None."""
    found = getattr(getattr(adapter, "serialPortOrig", None), "_socket", None)
    return found if isinstance(found, socket.socket) else None


def _shut(adapter: can.BusABC) -> None:
    """Close for good, whatever state the adapter is in.

    slcan writes before it closes, so on a dead link it never closes its port; and pyserial's socket sleeps 0.3 s and
    leaves the socket open where the peer is gone. So a socket is closed here.
    """
    port = getattr(adapter, "serialPortOrig", None)
    peer = _peer(adapter)
    if peer is not None and port is not None:
        with contextlib.suppress(Exception):
            port.write(b"C\r")
        port.is_open = False
        peer.close()
    with contextlib.suppress(Exception):
        adapter.shutdown()
    if port is not None:
        with contextlib.suppress(Exception):
            port.close()
