"""What the system's service manager is told: ready, alive (sd_notify(3), sd_watchdog_enabled(3)). Nothing elsewhere."""

from __future__ import annotations

import asyncio
import math
import os
import socket


def notify(state: str) -> None:
    """Tell the service manager, where there is one that wants to know. Never raises: nothing depends on it."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as manager:
        manager.setblocking(False)
        try:
            manager.sendto(state.encode(), address)
        except OSError:
            return


class Watchdog:
    """Tells the service manager that this process goes on. For one that asks nobody for that it does nothing."""

    def __init__(self) -> None:
        limit_us = int(os.environ.get("WATCHDOG_USEC", "0"))
        ours = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.period_s = 1e-6 * limit_us / 4 if limit_us and ours else math.inf
        self._due_s = -math.inf

    def feed(self, now: float) -> None:
        """Called at least every `period_s`, however often: says so four times within the limit. `now` in seconds."""
        if math.isfinite(self.period_s) and now >= self._due_s:
            self._due_s = now + self.period_s
            notify("WATCHDOG=1")


async def alive() -> None:
    """Say that this loop is ready, and then, for as long as it is awaited, that it turns.

    On the machine's own clock; one that stands still while heavy jobs are in flight says nothing meanwhile.
    """
    notify("READY=1")
    watchdog, loop = Watchdog(), asyncio.get_running_loop()
    if math.isinf(watchdog.period_s):
        await loop.create_future()
    while True:
        watchdog.feed(loop.time())
        await asyncio.sleep(watchdog.period_s)
