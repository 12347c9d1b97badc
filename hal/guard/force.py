"""The jack's force sensor where a guard process owns it, `hal.interfaces.ForceSensor`: samples from the shared ring."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hal.entries import ForceLineEntry
from hal.errors import DeviceTimeout, NotConnected
from hal.guard.files import ring_beside
from hal.guard.link import GuardLink
from hal.guard.ring import RingError, RingReader
from hal.interfaces import ForceBlock, Identity, SafeState

KEEP_S = 0.1
"""What is kept for a reader that comes late; one that comes later is told of the present."""
LOOK_S = 0.005
"""Between two looks at the ring; whoever must be faster is in the guard itself."""


JACK_FORCE = "jack_force"
"""What the guard knows it by."""


class RingForceSensor:
    """The guard does what is asked of the amplifier; nothing is asked for a sample."""

    def __init__(self, name: str, entry: ForceLineEntry, link: GuardLink, socket: Path) -> None:
        self.name = name
        self.rate_hz = entry.rate_hz
        self.range_n = entry.range_n
        self._silence_s = entry.silence_s
        self._link = link
        self._path = ring_beside(socket)
        self._ring: RingReader | None = None
        self._inode = 0
        self._next = 0

    async def connect(self) -> Identity:
        """Reach the guard and have it prove the amplifier. Raises as `hal.real.force.SerialForceSensor.connect`."""
        if self._ring is None:
            await self._link.reached()
        try:
            identity = Identity(**await self._link.call("connect", device=JACK_FORCE))
            self._follow()
        except BaseException:
            if self._ring is None:
                await self._link.release()
            raise
        return identity

    async def close(self) -> None:
        """Let go of the guard, which goes on."""
        if self._ring is not None:
            self._ring.close()
            self._ring = None
            await self._link.release()

    async def halt(self) -> None:
        """Nothing moves here; the exchange proves that the amplifier answers."""
        self._require("halt")
        await self._link.call("halt", device=JACK_FORCE)

    async def safe(self) -> SafeState:
        """Safe once it answers."""
        self._require("safe")
        return SafeState(**await self._link.call("safe", device=JACK_FORCE))

    async def rearm(self) -> None:
        """A stream that was ended is started again."""
        self._require("rearm")
        await self._link.call("rearm", device=JACK_FORCE)

    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        """See `hal.interfaces.ForceSensor.block`. Raises what is wrong with the line, NotConnected (no guard)."""
        loop = asyncio.get_running_loop()
        self._present()
        first, times_s, parts, have = 0, np.empty(0), [], 0
        heard_s = loop.time()
        while True:
            number, times, forces = self._require("block").take(self._next, count - have)
            if len(forces):
                if have and number != first + have:  # samples are missing: the block ends before the gap
                    self._next = number
                    break
                forces, ended = _until_outside(forces, low_n, high_n)
                if not have:
                    first, times_s = number, times
                parts.append(forces)
                have += len(forces)
                self._next, heard_s = number + len(forces), loop.time()
                if ended or have >= count:
                    break
                continue
            self._judge(loop.time() - heard_s)
            await asyncio.sleep(LOOK_S)
        return ForceBlock(first, float(times_s[0]), 1.0 / self.rate_hz, np.concatenate(parts))

    def _judge(self, silent_s: float) -> None:
        """Raise what keeps the samples away."""
        self._follow()
        if self._link.told is None:
            raise NotConnected("the guard is lost", device=self.name)
        if (error := self._link.told.sensor_error) is not None:
            raise error
        if silent_s > 2.0 * self._silence_s:  # the guard says so earlier where it is the line
            raise DeviceTimeout(f"no sample for {silent_s:g} s", device=self.name)

    def _present(self) -> None:
        ring = self._require("block")
        if ring.next - self._next > max(1, round(KEEP_S * self.rate_hz)):
            self._next = ring.next

    def _follow(self) -> None:
        """The ring of the guard that runs now; another one counts from 0 again."""
        try:
            inode = self._path.stat().st_ino
            if self._ring is not None and inode == self._inode:
                return
            ring = RingReader(self._path)
        except (OSError, RingError) as error:
            if self._ring is None:
                raise NotConnected(f"no ring of samples: {error}", device=self.name) from None
            return
        if self._ring is not None:
            self._ring.close()
        self._ring, self._inode, self._next = ring, inode, ring.next

    def _require(self, command: str) -> RingReader:
        if self._ring is None:
            raise NotConnected(f"not connected ({command})", device=self.name)
        return self._ring


def _until_outside(forces: NDArray[np.float64], low_n: float, high_n: float) -> tuple[NDArray[np.float64], bool]:
    """Samples up to the first that is not within [low, high], and whether there is one."""
    outside = ~((forces >= low_n) & (forces <= high_n))
    return (forces[: int(np.argmax(outside)) + 1], True) if outside.any() else (forces, False)
