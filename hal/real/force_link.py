"""One open line to a force amplifier: requests with their answers, and the samples in between."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVar

from hal.bus.serial import SerialLine
from hal.codec.force_line import (
    LONGEST,
    ForceLineError,
    IdentityTold,
    Request,
    Sample,
    StateTold,
    Verb,
    decode,
    encode,
    split,
)
from hal.errors import DeviceTimeout, NotConnected

Answer = IdentityTold | StateTold
A = TypeVar("A", IdentityTold, StateTold)


class AmplifierLink:
    """Open at once. Samples go to `on_samples`, chunk by chunk; `on_lost` hears once that the line broke.

    Raises NotConnected where the port cannot be opened.
    """

    def __init__(
        self,
        name: str,
        path: str,
        baud: int,
        reply_s: float,
        on_samples: Callable[[list[Sample]], None],
        on_lost: Callable[[NotConnected], None],
    ) -> None:
        self.unreadable = 0
        """Lines since the last readable sample that were none; `wrong` says what was wrong with the last."""
        self.wrong = ""
        self._name = name
        self._reply_s = reply_s
        self._on_samples = on_samples
        self._on_lost = on_lost
        self._rest = b""
        self._tag = 0
        self._asked: dict[int, asyncio.Future[Answer]] = {}
        try:
            self._line = SerialLine(path, baud, self._read, self._lost)
        except OSError as error:
            raise NotConnected(f"port {path}: {error}", device=name) from None

    @property
    def is_open(self) -> bool:
        """False once closed or lost."""
        return self._line.is_open

    def close(self, reason: str = "closed") -> None:
        """Ask for no more samples, if anybody still hears it, and give the port back; who waits for an answer hears
        `reason`."""
        if self._line.is_open:
            self.say("stop")
            self._line.close()
        self._fail(reason)

    def say(self, verb: Verb) -> None:
        """Ask without waiting for an answer; nobody need hear it."""
        try:
            self._send(verb)
        except NotConnected:
            self._line.close()

    async def identify(self) -> IdentityTold:
        """Who is there. Raises DeviceTimeout, NotConnected."""
        return await self._ask("identify", IdentityTold)

    async def ask(self, verb: Verb) -> StateTold:
        """The state after `verb`. Raises DeviceTimeout, NotConnected."""
        return await self._ask(verb, StateTold)

    async def _ask(self, verb: Verb, kind: type[A]) -> A:
        tag = self._send(verb)
        answer = self._asked[tag] = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(self._reply_s):
                told = await answer
        except TimeoutError:
            hint = f" ({self.unreadable} unreadable lines, the last: {self.wrong})" if self.unreadable else ""
            raise DeviceTimeout(f"no answer to {verb} within {self._reply_s:g} s{hint}", device=self._name) from None
        finally:
            del self._asked[tag]
        if not isinstance(told, kind):
            raise DeviceTimeout(f"{verb} was answered by {told}", device=self._name)
        return told

    def _send(self, verb: Verb) -> int:
        self._tag += 1
        try:
            self._line.write(encode(Request(self._tag, verb)))
        except OSError as error:
            raise NotConnected(f"{verb}: {error}", device=self._name) from None
        return self._tag

    def _read(self, data: bytes) -> None:
        lines, self._rest = split(self._rest + data)
        if len(self._rest) >= LONGEST:
            self._unread(f"{LONGEST} bytes without a line feed")
            self._rest = b""
        samples: list[Sample] = []
        for line in lines:
            try:
                message = decode(line)
            except ForceLineError as error:
                self._unread(str(error))
                continue
            if isinstance(message, Sample):
                samples.append(message)
            elif not isinstance(message, Request) and (asked := self._asked.get(message.tag)) and not asked.done():
                asked.set_result(message)
        if samples:
            self.unreadable = 0
            self._on_samples(samples)

    def _unread(self, why: str) -> None:
        self.unreadable += 1
        self.wrong = why

    def _lost(self, reason: str) -> None:
        self._fail(f"the line broke ({reason})")
        self._on_lost(NotConnected(f"the line broke ({reason})", device=self._name))

    def _fail(self, reason: str) -> None:
        for asked in self._asked.values():
            if not asked.done():
                asked.set_exception(NotConnected(reason, device=self._name))
