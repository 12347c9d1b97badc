"""One TCP connection to an Open Protocol controller, and the link that keeps one alive.

A `Session` is one connection: one message outstanding, a deadline on every exchange, a keep-alive after 10 s without
traffic. A message that may be repeated is sent up to 3 times; one that starts something is sent once, and where its
answer does not come the outcome is unknown. A session that missed a deadline is closed: on a fresh connection no late
answer can be taken for another one's.

A `Link` owns the sessions: it opens one, and when it is lost opens the next.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from hal.codec.open_protocol import Framer, Message, OpenProtocolError, encode
from hal.codec.open_protocol_messages import ACCEPTED, ANSWERS, ERRORS, KEEP_ALIVE, REFUSED, read_number, read_refused
from hal.errors import DeviceError, DeviceRefused, DeviceTimeout, NotConnected, UnknownOutcome

SENDS = 3
RESEND_S = 1.2
"""An answer is waited for so long before the message is sent again; three times that is the exchange's deadline."""
IDLE_S = 10.0
OPEN_S = 2.0
RETRY_S = 1.0


class Refused(DeviceRefused):
    """The controller answered MID 0004; nothing acted. `error` is its code."""

    def __init__(self, mid: int, error: int, *, device: str) -> None:
        super().__init__(
            f"MID {mid:04d} refused: error {error:02d} ({ERRORS.get(error, 'see the specification')})", device=device
        )
        self.error = error


@dataclass(slots=True)
class _Exchange:
    """The one message that is outstanding. `mids` are the names under which 0004 and 0005 may answer it."""

    request: Message
    mids: frozenset[int]
    first: int
    """Number of its first sending among all of its MID on this connection."""
    answer: asyncio.Future[Message] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class Session:
    """One connection, from TCP connect to its loss."""

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        on_event: Callable[[Session, Message], None],
        device: str,
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._on_event = on_event
        self._device = device
        self._turn = asyncio.Lock()
        self._exchange: _Exchange | None = None
        self._sent: Counter[int] = Counter()
        self._answered: Counter[int] = Counter()
        self._traffic_s = asyncio.get_running_loop().time()
        self._lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._tasks = [
            asyncio.create_task(self._read(), name=f"{device} read"),
            asyncio.create_task(self._keep_alive(), name=f"{device} keep-alive"),
        ]

    @property
    def lost(self) -> str:
        """Why the connection is no more; empty while it is there."""
        return self._lost.result() if self._lost.done() else ""

    async def wait_lost(self) -> str:
        """Wait for the end of the connection and return why."""
        return await asyncio.shield(self._lost)

    def lose(self, reason: str) -> None:
        """End the connection now, without a word to the other side."""
        if self._lost.done():
            return
        self._lost.set_result(reason)
        if self._exchange is not None and not self._exchange.answer.done():
            self._exchange.answer.set_exception(NotConnected(f"link lost: {reason}", device=self._device))
            self._exchange.answer.exception()
        self._writer.transport.abort()

    async def close(self) -> None:
        """End the connection and everything that works on it."""
        self.lose("closed")
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()

    def tell(self, message: Message) -> None:
        """Send an acknowledgement, which nobody answers. On a lost connection nothing happens."""
        if not self._lost.done():
            self._write(message)

    async def ask(
        self,
        request: Message,
        *,
        subject: int = 0,
        repeatable: bool = True,
        guard: Callable[[], None] | None = None,
    ) -> Message:
        """Send `request` and return its answer. `subject` is the MID that a general request is about.

        `guard` is called right before anything is sent and may raise. Raises Refused, DeviceTimeout, NotConnected, and
        UnknownOutcome where a request that must not be repeated was sent and not answered.
        """
        async with self._turn:
            if self._lost.done():
                raise NotConnected(f"link lost: {self.lost}", device=self._device)
            mids = frozenset({request.mid, subject or request.mid})
            exchange = self._exchange = _Exchange(request, mids, self._sent[request.mid] + 1)
            try:
                return await self._exchanged(exchange, repeatable, guard)
            finally:
                self._exchange = None

    async def _exchanged(self, exchange: _Exchange, repeatable: bool, guard: Callable[[], None] | None) -> Message:
        request = exchange.request
        sends = SENDS if repeatable else 1
        try:
            for _ in range(sends):
                if guard is not None:
                    guard()
                self._sent[request.mid] += 1
                self._write(request)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(RESEND_S * SENDS / sends):
                        return self._checked(await asyncio.shield(exchange.answer))
        except (asyncio.CancelledError, NotConnected) as error:
            if repeatable or self._sent[request.mid] < exchange.first:
                raise
            self.lose(f"{request} was given up")
            if isinstance(error, asyncio.CancelledError):
                raise
            raise UnknownOutcome(f"link lost after {request} was sent", device=self._device) from None
        reason = f"no answer to {request} within {RESEND_S * SENDS:g} s"
        self.lose(reason)
        raise (DeviceTimeout if repeatable else UnknownOutcome)(reason, device=self._device)

    def _checked(self, answer: Message) -> Message:
        if answer.mid == REFUSED:
            raise Refused(*read_refused(answer), device=self._device)
        return answer

    def _write(self, message: Message) -> None:
        self._traffic_s = asyncio.get_running_loop().time()
        self._writer.write(encode(message))

    async def _read(self) -> None:
        framer = Framer()
        try:
            while received := await self._reader.read(65536):
                self._traffic_s = asyncio.get_running_loop().time()
                for message in framer.feed(received):
                    self._take(message)
            self.lose("the controller closed it")
        except (OSError, OpenProtocolError) as error:
            self.lose(str(error) or type(error).__name__)

    def _take(self, message: Message) -> None:
        """Answers go to the exchange that they answer; what answers an earlier sending is dropped; the rest are events.

        The controller answers in order, so the n-th answer to a MID belongs to its n-th sending. One that never came
        makes the count lag; the next sending then catches up.
        """
        exchange, mid = self._exchange, self._answers(message)
        if mid is None:
            self._on_event(self, message)
            return
        if exchange is not None and mid in exchange.mids:
            mid = exchange.request.mid
        self._answered[mid] += 1
        ours = exchange is not None and mid == exchange.request.mid
        if exchange is not None and ours and self._answered[mid] >= exchange.first and not exchange.answer.done():
            exchange.answer.set_result(message)

    def _answers(self, message: Message) -> int | None:
        """The MID that `message` answers, or None."""
        if message.mid == REFUSED:
            return read_refused(message)[0]
        if message.mid == ACCEPTED:
            return read_number(message, 4)
        if self._exchange is not None and message.mid in self._exchange.mids:
            return message.mid
        return ANSWERS.get(message.mid)

    async def _keep_alive(self) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(DeviceError):
            while True:
                if (wait_s := self._traffic_s + IDLE_S - loop.time()) > 0.0:
                    await asyncio.sleep(wait_s)
                else:
                    await self.ask(Message(KEEP_ALIVE))


class Link:
    """Keeps a session open. `prepare` is run on each new one before anybody else may use it."""

    def __init__(
        self,
        host: str,
        port: int,
        *,
        device: str,
        prepare: Callable[[Session], Awaitable[None]],
        on_event: Callable[[Session, Message], None],
    ) -> None:
        self._host = host
        self._port = port
        self._device = device
        self._prepare = prepare
        self._on_event = on_event
        self._session: Session | None = None
        self._why = "not connected"
        self._monitor: asyncio.Task[None] | None = None

    @property
    def up(self) -> bool:
        """Whether there is a session to be used."""
        return self._session is not None and not self._session.lost

    def session(self) -> Session:
        """The present session. Raises NotConnected."""
        if self._session is None or self._session.lost:
            why = f"link lost: {self._session.lost}" if self._session is not None else self._why
            raise NotConnected(why, device=self._device)
        return self._session

    async def open(self) -> None:
        """Have a session, a fresh one where there is none. Raises DeviceError; then nothing is left."""
        if self.up:
            return
        await self.close()
        self._session = await self._opened()
        self._monitor = asyncio.create_task(self._keep(), name=f"{self._device} link")

    async def close(self) -> None:
        """End the session and do not open another one."""
        if self._monitor is not None:
            self._monitor.cancel()
            await asyncio.gather(self._monitor, return_exceptions=True)
            self._monitor = None
        if self._session is not None:
            await self._session.close()
            self._session = None
        self._why = "not connected"

    async def _opened(self) -> Session:
        try:
            async with asyncio.timeout(OPEN_S):
                streams = await asyncio.open_connection(self._host, self._port)
        except TimeoutError:
            raise DeviceTimeout(f"{self._host}:{self._port} does not answer", device=self._device) from None
        except OSError as error:
            raise NotConnected(f"{self._host}:{self._port}: {error}", device=self._device) from None
        session = Session(*streams, self._on_event, self._device)
        try:
            await self._prepare(session)
        except BaseException:
            await session.close()
            raise
        return session

    async def _keep(self) -> None:
        """The monitor: whenever the session is lost, open the next."""
        while True:
            if self._session is not None:
                self._why = f"link lost: {await self._session.wait_lost()}"
                await self._session.close()
                self._session = None
            try:
                self._session = await self._opened()
            except DeviceError as error:
                self._why = error.reason
                await asyncio.sleep(RETRY_S)
