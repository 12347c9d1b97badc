"""What happened in the cell, numbered without a gap, for any number of readers that come and go."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import takewhile


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened. `data` is JSON; `time` is aware, UTC; `sequence` grows by one from 1."""

    sequence: int
    time: datetime
    kind: str
    data: Mapping[str, object]


class EventLog:
    """Keeps the newest `keep` events; a reader follows at its own pace and costs nothing while it is slow.

    `boot` tells this log from that of the service before its restart, whose numbers began at 1 too: it is the
    microsecond in which the log was made.
    """

    def __init__(self, now: Callable[[], datetime], *, keep: int = 10_000) -> None:
        self._now = now
        self._boot = f"{now().timestamp() * 1e6:.0f}"
        self._events: deque[Event] = deque(maxlen=keep)
        self._last = 0
        self._closed = False
        self._news = asyncio.Event()

    @property
    def boot(self) -> str:
        """Digits; another log has others."""
        return self._boot

    @property
    def last(self) -> int:
        """Number of the newest event, 0 before the first."""
        return self._last

    @property
    def last_id(self) -> str:
        """`id_of` the newest event."""
        return self.id_of(self._last)

    def id_of(self, sequence: int) -> str:
        """What names an event of that number, apart from the one of that number in another log."""
        return f"{self._boot}-{sequence}"

    @property
    def first(self) -> int:
        """Number of the oldest event that is still kept."""
        return self._last - len(self._events) + 1

    def publish(self, kind: str, data: Mapping[str, object]) -> Event:
        """Add an event and wake all readers."""
        self._last += 1
        event = Event(self._last, self._now(), kind, data)
        self._events.append(event)
        self._wake()
        return event

    def close(self) -> None:
        """End every `follow`, so that no open stream delays the end of the service."""
        self._closed = True
        self._wake()

    def since(self, sequence: int) -> list[Event]:
        """Events after number `sequence` that are still kept, oldest first."""
        newer = list(takewhile(lambda event: event.sequence > sequence, reversed(self._events)))
        newer.reverse()
        return newer

    async def follow(self, after: int) -> AsyncIterator[Event]:
        """Every event after number `after`, then each new one as it comes, until the log is closed.

        A reader that asks for a number that is not kept any more gets the oldest kept one first.
        """
        while True:
            for event in self.since(after):
                after = event.sequence
                yield event
            if self._closed:
                return
            if after >= self._last:
                await self._news.wait()

    def _wake(self) -> None:
        self._news.set()
        self._news = asyncio.Event()
