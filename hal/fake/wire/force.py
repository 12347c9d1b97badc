"""Simulator of a force amplifier: streams lines on a pseudo-terminal, a fake force sensor on the plant behind it.

Sample numbers follow from the sensor's own sample times, so that samples that the sensor lost are missing here too.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hal.bus.pty import Pty
from hal.codec.force_line import (
    ForceLineError,
    IdentityTold,
    Message,
    Request,
    Sample,
    StateTold,
    decode,
    encode,
    split,
)
from hal.errors import DeviceTimeout
from hal.fake.faults import FaultBook
from hal.interfaces import ForceBlock, ForceSensor


@dataclass
class WireFaults:
    """What is still to go wrong on the line; counts are of sample lines."""

    drop: int = 0
    """Lines that are lost."""
    corrupt: int = 0
    """Lines with one wrong bit."""
    half: int = 0
    """Lines of which the second half is missing, with their line feed."""
    repeat: int = 0
    """Lines that are sent twice."""
    frozen: bool = False
    """The same line is sent instead of each next one."""
    garbage: bool = False
    """Nothing readable is sent, as with a wrong baud rate."""
    late_answers: int = 0
    """Answers that come together with the next one."""

    def line(self, line: bytes, before: bytes) -> bytes:
        """What becomes of a sample's `line`, `before` being the one before it."""
        if self.frozen and before:
            return before
        if self.drop:
            self.drop -= 1
            return b""
        if self.corrupt:
            self.corrupt -= 1
            return line[:9] + bytes([line[9] ^ 0x01]) + line[10:]
        if self.half:
            self.half -= 1
            return line[: len(line) // 2]
        if self.repeat:
            self.repeat -= 1
            return line + line
        return line


class ForceAmplifier:
    """One amplifier at the port `path`. `sensor` must not act out faults of the link itself (see `behind.BehindWire`).

    `burst` samples are sent at a time, as an adapter with a latency timer does.
    """

    def __init__(self, sensor: ForceSensor, faults: FaultBook, path: Path, *, burst: int = 1) -> None:
        self.name = sensor.name
        self.serial = f"{sensor.name}-1"
        self.wire = WireFaults()
        self._sensor = sensor
        self._faults = faults
        self._pty = Pty(path, self._read)
        self._burst = burst
        self._rest = b""
        self._line = b""
        self._stream: asyncio.Task[None] | None = None
        self._timers: deque[asyncio.TimerHandle] = deque()
        self._held: list[bytes] = []
        self._end_gone: Callable[[], None] | None = None

    @property
    def streaming(self) -> bool:
        """Whether samples are being sent."""
        return self._stream is not None and not self._stream.cancelling()

    async def start(self) -> None:
        """Power on and plugged in."""
        loop = asyncio.get_running_loop()
        self._end_gone = self._faults.when(self.name, "gone", self._gone)
        if self._faults.active(self.name, "gone", loop.time()) is None:
            self._pty.plug()

    async def close(self) -> None:
        """Power off and unplugged."""
        if self._end_gone is not None:
            self._end_gone()
        self.unplug()
        await self.power_off()

    def plug(self) -> None:
        """Plug the cable in."""
        self._pty.plug()

    def unplug(self) -> None:
        """Pull the cable; the amplifier goes on."""
        self._pty.unplug()
        self._rest = b""

    async def power_off(self) -> None:
        """The stream ends; when power comes back the amplifier waits to be started."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        if self._stream is not None:
            self._stream.cancel()
            await asyncio.wait({self._stream})
            self._stream = None
        await self._sensor.close()

    def _gone(self) -> None:
        self.unplug()
        loop = asyncio.get_running_loop()
        fault = self._faults.active(self.name, "gone", loop.time())
        if fault is not None and math.isfinite(fault.duration_s):
            self._timers.append(loop.call_at(self._faults.start_s(fault) + fault.duration_s, self.plug))

    # ------------------------------------------------------------ requests

    def _read(self, data: bytes) -> None:
        lines, self._rest = split(self._rest + data)
        for line in lines:
            try:
                request = decode(line)
            except ForceLineError:
                continue  # an amplifier does not answer what it cannot read
            if isinstance(request, Request):
                self._later(request)

    def _later(self, request: Request) -> None:
        """Answer at once, or once the amplifier hangs no more."""
        now = asyncio.get_running_loop().time()
        if (hung := self._faults.active(self.name, "hung", now)) is None:
            self._obey(request)
        elif math.isfinite(hung.duration_s):
            due_s = self._faults.start_s(hung) + hung.duration_s
            self._timers.append(asyncio.get_running_loop().call_at(due_s, self._obey, request))

    def _obey(self, request: Request) -> None:
        tag = request.tag
        match request.verb:
            case "identify":
                sensor = self._sensor
                told: Message = IdentityTold(
                    tag, "cellctl", "load cell", self.serial, "1.0", sensor.rate_hz, sensor.range_n
                )
                self._answer(told)
                return
            case "start" if not self.streaming:
                self._stream = asyncio.get_running_loop().create_task(self._run(), name=f"{self.name} amplifier")
            case "stop" if self._stream is not None:
                self._stream.cancel()
        self._answer(StateTold(tag, self.streaming))

    def _answer(self, told: Message) -> None:
        self._held.append(encode(told))
        if self.wire.late_answers:
            self.wire.late_answers -= 1
            return
        self._send(b"".join(self._held))
        self._held.clear()

    # ------------------------------------------------------------ samples

    async def _run(self) -> None:
        await self._sensor.connect()
        first_s: float | None = None
        try:
            while True:
                try:
                    block = await self._sensor.block(self._burst)
                except DeviceTimeout:  # it has nothing new
                    continue
                first_s = block.time_s if first_s is None else first_s
                self._tell(block, round((block.time_s - first_s) / block.period_s))
        finally:
            await self._sensor.close()

    def _tell(self, block: ForceBlock, first: int) -> None:
        if self._faults.active(self.name, "hung", asyncio.get_running_loop().time()):
            return
        data = b""
        for number, force_n in enumerate(block.samples_n.tolist(), start=first):
            beyond = abs(force_n) >= self._sensor.range_n
            line = encode(Sample(number, math.copysign(math.inf, force_n) if beyond else force_n))
            self._line = line = self.wire.line(line, self._line)
            data += line
        self._send(bytes(byte ^ 0x80 for byte in data) if self.wire.garbage else data)

    def _send(self, data: bytes) -> None:
        """Send, `late` by what the fault says; nothing overtakes."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        while self._timers and (self._timers[0].cancelled() or self._timers[0].when() < now):
            self._timers.popleft()
        late = self._faults.active(self.name, "late", now)
        if late is not None:
            self._timers.append(loop.call_at(now + late.number, self._pty.write, data))
        else:
            self._pty.write(data)
