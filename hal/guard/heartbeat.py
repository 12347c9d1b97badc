"""The controller's heartbeat on the CAN bus beside an in-loop guard: drives stop when it stops."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

BEATS = 4
"""Beats in the time after which who hears none acts on it: one may be lost, another late."""


class Heartbeat:
    """Calls `send` every `period_s` while `alive`: where the guard died or the loop hangs, the drives stop."""

    def __init__(self, send: Callable[[], None], alive: Callable[[], bool], period_s: float) -> None:
        self._send = send
        self._alive = alive
        self._period_s = period_s
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin, unless it goes on already."""
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._beat(), name="heartbeat")

    async def close(self) -> None:
        """No beat is sent any more; no task is left."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.wait({task})

    async def _beat(self) -> None:
        while True:
            if self._alive():
                self._send()
            await asyncio.sleep(self._period_s)
