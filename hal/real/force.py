"""Force amplifier that streams lines over a serial port, `hal.interfaces.ForceSensor`.

A line that is broken or repeated is no sample: it shows in the numbering. A block that meets a gap ends before it. A
line that broke, or an amplifier that fell silent, is asked for anew by the next command; the numbering then jumps.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable

from hal.codec.force_line import IdentityTold, Sample
from hal.entries import ForceLineEntry
from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, NotConnected
from hal.interfaces import ForceBlock, Identity, SafeState
from hal.real.force_link import AmplifierLink
from hal.real.force_stream import Gathering, Stream

SIMULATOR = "cellctl"
"""What a simulator calls its vendor."""
KEEP_S = 0.1
"""What is kept for a reader that comes late; older samples are lost."""


class SerialForceSensor:
    """One reader. No task and no thread: the loop reads the port.

    `tap` is handed all samples at once when they come, without gaps, before whoever waits for a block is woken.
    """

    def __init__(self, name: str, entry: ForceLineEntry, tap: Callable[[ForceBlock], None] | None = None) -> None:
        self._name = name
        self._entry = entry
        self._tap = tap
        self._stream = Stream(1.0 / entry.rate_hz, max(1, int(KEEP_S * entry.rate_hz)))
        self._link: AmplifierLink | None = None
        self._wanted = False
        self._opening = asyncio.Lock()
        self._known: Identity | None = None

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self._entry.rate_hz

    @property
    def range_n(self) -> float:
        """Beyond it the reading saturates."""
        return self._entry.range_n

    async def connect(self) -> Identity:
        """Open the port, prove the amplifier's identity, rate and range; the stream starts.

        Raises NotConnected (no port, or in use), DeviceTimeout, DeviceRefused (not the amplifier of the cell file).
        """
        link = await self._linked("connect", wanted=True)
        self._wanted = True
        return self._identity(await link.identify())

    async def close(self) -> None:
        """Stop the stream, give the port back."""
        self._wanted, self._known = False, None
        self._drop(NotConnected("closed", device=self._name))

    async def halt(self) -> None:
        """Nothing moves here; the exchange proves that the amplifier answers."""
        await (await self._linked("halt")).ask("state")

    async def safe(self) -> SafeState:
        """Safe once it answers."""
        told = await (await self._linked("safe")).ask("state")
        return SafeState(True, f"{self._name} only measures" + ("" if told.streaming else ", and nothing at present"))

    async def rearm(self) -> None:
        """No set-point to be changed; a stream that was ended, as by a power-cycle, is started again."""
        told = await (await self._linked("rearm")).ask("state")
        if not told.streaming:
            self._drop(NotConnected("started again", device=self._name))
            await self._linked("rearm")

    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        """See `hal.interfaces.ForceSensor.block`. A reading beyond the range is the end of the range.

        Raises NotConnected, DeviceTimeout (silent), ImplausibleReading (repeats itself), DeviceFault (unreadable),
        DeviceRefused (somebody else reads).
        """
        link = await self._linked("block")
        if self._stream.busy:
            raise DeviceRefused("it has one reader, and that one is reading", device=self._name)
        gathering = Gathering(count, low_n, high_n)
        self._stream.gather(gathering)
        try:
            await self._until(gathering, link)
        except asyncio.CancelledError:
            self._stream.forget()  # it gathered for a reader that is gone: the next one is told of the present
            raise
        finally:
            self._stream.leave()
        return self._stream.block(gathering)

    # ------------------------------------------------------------ the line

    async def _linked(self, command: str, *, wanted: bool = False) -> AmplifierLink:
        """The open line; one that was lost is opened again."""
        if not (self._wanted or wanted):
            raise NotConnected(f"not connected ({command})", device=self._name)
        if self._link is not None and self._link.is_open:
            return self._link
        async with self._opening:
            if self._link is None or not self._link.is_open:
                self._link = await self._open()
            return self._link

    async def _open(self) -> AmplifierLink:
        entry = self._entry
        link = AmplifierLink(self._name, entry.path, entry.baud, entry.reply_s, self._take, self._stream.fail)
        try:
            await link.ask("stop")
            self._identity(await link.identify())
            self._stream.restart()
            if not (await link.ask("start")).streaming:
                raise DeviceFault("it does not start its stream", device=self._name)
        except BaseException:
            link.close()
            raise
        return link

    def _identity(self, told: IdentityTold) -> Identity:
        """Who is there. Raises DeviceRefused where it is not who was meant, or samples otherwise."""
        entry = self._entry
        identity = Identity(told.vendor, told.model, told.serial, told.firmware, simulated=told.vendor == SIMULATOR)
        serial = entry.serial or (self._known.serial if self._known else told.serial)
        if told.serial != serial:
            raise DeviceRefused(f"amplifier {told.serial} answers, {serial} is meant", device=self._name)
        if (told.rate_hz, told.range_n) != (entry.rate_hz, entry.range_n):
            is_, meant = f"{told.rate_hz:g} Hz, {told.range_n:g} N", f"{entry.rate_hz:g} Hz, {entry.range_n:g} N"
            raise DeviceRefused(f"the amplifier is set to {is_}, the cell file says {meant}", device=self._name)
        self._known = identity
        return identity

    def _drop(self, error: DeviceError) -> None:
        self._stream.fail(error)
        if self._link is not None:
            self._link.close(error.reason)
        self._link = None

    # ------------------------------------------------------------ samples

    def _take(self, samples: list[Sample]) -> None:
        came = [
            (self._stream.next - 1, force_n)
            for sample in samples
            if self._stream.take(sample.sequence, force_n := self._within(sample.force_n))
        ]
        if came:
            self._stream.arrived(asyncio.get_running_loop().time())
            if self._tap is not None:
                for block in self._stream.blocks(came):
                    self._tap(block)

    def _within(self, force_n: float) -> float:
        return math.copysign(self._entry.range_n, force_n) if math.isinf(force_n) else force_n

    async def _until(self, gathering: Gathering, link: AmplifierLink) -> None:
        """Wait for what is gathered, as long as something comes."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        while not gathering.done.is_set():
            due_s = max(begun_s, self._stream.new_s) + self._entry.silence_s
            if due_s <= loop.time():
                self._drop(self._silence(link))
                break
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(due_s):
                    await gathering.done.wait()
        if gathering.error is not None:
            raise gathering.error

    def _silence(self, link: AmplifierLink) -> DeviceError:
        """Why nothing has come."""
        since = f"for {self._entry.silence_s:g} s"
        if self._stream.repeated:
            return ImplausibleReading(f"it repeats old samples {since}", device=self._name)
        if link.unreadable:
            text = f"{link.unreadable} unreadable lines and no other {since}, the last: {link.wrong}"
            return DeviceFault(text, device=self._name)
        return DeviceTimeout(f"no sample {since}", device=self._name)
