"""The one source of wall clock, cell time and ids. Chosen by the composition root, injected everywhere else.

Under virtual time the wall clock starts at 2000-01-01T00:00:00Z and ids follow from the seed, so that a journal is
the same bits in another process.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from datetime import UTC, datetime, timedelta
from typing import Protocol

EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
"""Where virtual time starts."""


class Stamps(Protocol):
    """Wall clock (aware, UTC), cell time in seconds (monotonic) and fresh ids."""

    def now(self) -> datetime: ...
    def cell_time_s(self) -> float: ...
    def new_id(self, kind: str) -> str:
        """An id that was never given before, `kind` in front of it."""
        ...


class VirtualStamps:
    """Time from the running event loop, ids from the seed.

    `start` tells controllers apart that were started one after the other on the same seed: a restarted controller
    must never give out a key that its forerunner used.
    """

    def __init__(self, seed: int, *, start: int = 0) -> None:
        self._seed = seed
        self._start = start
        self._given = 0

    def now(self) -> datetime:
        return EPOCH + timedelta(seconds=self.cell_time_s())

    def cell_time_s(self) -> float:
        return asyncio.get_running_loop().time()

    def new_id(self, kind: str) -> str:
        self._given += 1
        digest = hashlib.sha256(f"{self._seed}/{self._start}/{self._given}".encode()).hexdigest()
        return f"{kind}-{digest[:16]}"


class WallStamps:
    """For the service: the machine's UTC clock, the loop's monotonic seconds since the service started, random ids."""

    def __init__(self) -> None:
        self._origin_s: float | None = None

    def now(self) -> datetime:
        return datetime.now(UTC)

    def cell_time_s(self) -> float:
        now_s = asyncio.get_running_loop().time()
        if self._origin_s is None:
            self._origin_s = now_s
        return now_s - self._origin_s

    def new_id(self, kind: str) -> str:
        return f"{kind}-{secrets.token_hex(8)}"


def rfc3339(moment: datetime) -> str:
    """RFC 3339 with microseconds and Z. `moment` is aware."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
