"""The samples of a force sensor as its line brings them: numbered without end, timed, kept for one late reader.

A sample's time is its number on the amplifier's own clock. Where that clock stands against the loop's is learnt from
the arrivals: no sample comes before it was taken, so the earliest arrival counts, and is forgotten at the rate by
which two clocks may differ. Late lines therefore show as old samples and never as samples of the present.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hal.codec.force_line import MODULO
from hal.interfaces import ForceBlock

CLOCKS_DIFFER = 5e-4
"""Two clocks run no further apart, s/s; an amplifier that samples slower ages its samples, as it should."""


@dataclass(slots=True)
class Gathering:
    """What one reader waits for: `count` samples without a gap, or fewer, up to the first not within [low, high]."""

    count: int
    low_n: float
    high_n: float
    first: int = 0
    have: int = 0
    done: asyncio.Event = field(default_factory=asyncio.Event)
    error: Exception | None = None

    def look(self, number: int, force_n: float) -> None:
        """At the next sample."""
        if self.done.is_set():
            return
        if self.have == 0:
            self.first = number
        elif number != self.first + self.have:  # samples are missing: the block ends before the gap
            self.done.set()
            return
        self.have += 1
        if self.have >= self.count or not self.low_n <= force_n <= self.high_n:
            self.done.set()


class Stream:
    """Fed by the line, read by one reader. `keep` samples wait for a late reader; with more of them all are dropped."""

    def __init__(self, period_s: float, keep: int) -> None:
        self.period_s = period_s
        self.next = 0
        """Number of the next sample, counted since the first connect."""
        self.new_s = -math.inf
        """When a sample came last that had not come before."""
        self.repeated = 0
        """Lines since then with a number that had come before."""
        self._keep = keep
        self._base = 0
        self._origin_s = math.inf
        self._looked_s = 0.0
        self._kept: deque[tuple[int, float]] = deque()
        self._gathering: Gathering | None = None

    def restart(self) -> None:
        """The amplifier counts from 0 again; what was missed meanwhile shows as one missing sample."""
        self.next = self._base = self.next + 1 if self.next else 0
        self._origin_s, self.repeated = math.inf, 0
        self._kept.clear()

    def take(self, sequence: int, force_n: float) -> bool:
        """The next line's sample; whether it is one that had not come before."""
        ahead = (sequence - (self.next - self._base)) % MODULO
        if ahead >= MODULO // 2:
            self.repeated += 1
            return False
        number = self.next + ahead
        self.next, self.repeated = number + 1, 0
        if self._gathering is None and len(self._kept) >= self._keep:
            self._kept.clear()
        self._kept.append((number, force_n))
        if self._gathering is not None:
            self._gathering.look(number, force_n)
        return True

    def arrived(self, now: float) -> None:
        """The samples up to the newest one have come by loop time `now`."""
        drifted_s = self._origin_s + CLOCKS_DIFFER * (now - self._looked_s)
        self._origin_s = min(drifted_s, now - (self.next - 1) * self.period_s)
        self._looked_s = self.new_s = now

    @property
    def busy(self) -> bool:
        """Whether a reader waits."""
        return self._gathering is not None

    def gather(self, gathering: Gathering) -> None:
        """Begin with what is kept."""
        for number, force_n in self._kept:
            gathering.look(number, force_n)
        self._gathering = gathering

    def leave(self) -> None:
        """The reader waits no longer; what it has not taken is kept."""
        self._gathering = None

    def forget(self) -> None:
        """A reader gave up: more than what is kept for a late one shows as missing samples."""
        if len(self._kept) > self._keep:
            self._kept.clear()

    def fail(self, error: Exception) -> None:
        """Whoever waits hears of it."""
        if self._gathering is not None and not self._gathering.done.is_set():
            self._gathering.error = error
            self._gathering.done.set()

    def block(self, gathering: Gathering) -> ForceBlock:
        """Take what was gathered."""
        values = [self._kept.popleft()[1] for _ in range(gathering.have)]
        time_s = self._origin_s + gathering.first * self.period_s
        return ForceBlock(gathering.first, time_s, self.period_s, np.array(values, dtype=np.float64))

    def blocks(self, came: list[tuple[int, float]]) -> Iterator[ForceBlock]:
        """Numbered samples that came together, cut where one is missing."""
        start = 0
        for end in range(1, len(came) + 1):
            if end == len(came) or came[end][0] != came[end - 1][0] + 1:
                first, part = came[start][0], [force_n for _, force_n in came[start:end]]
                time_s = self._origin_s + first * self.period_s
                yield ForceBlock(first, time_s, self.period_s, np.array(part, dtype=np.float64))
                start = end
