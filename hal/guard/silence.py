"""A deadline that is moved on with every block and hardly ever met."""

from __future__ import annotations

import asyncio
import math


class Silence:
    """Lets `timeout` strike once `due_s` passes. The timer is set anew when it falls due, not with every block."""

    def __init__(self, timeout: asyncio.Timeout) -> None:
        self._timeout = timeout
        self._loop = asyncio.get_running_loop()
        self._due_s = math.inf
        self._timer: asyncio.TimerHandle | None = None

    def over_by(self, due_s: float) -> None:
        """The next block must have come by loop time `due_s`."""
        self._due_s = due_s
        if self._timer is None or due_s < self._timer.when():
            self._set()

    def end(self) -> None:
        """Nothing strikes any more."""
        if self._timer is not None:
            self._timer.cancel()

    def _set(self) -> None:
        self.end()
        self._timer = self._loop.call_at(self._due_s, self._look)

    def _look(self) -> None:
        if self._loop.time() < self._due_s:
            self._set()
        else:
            self._timeout.reschedule(self._due_s)
