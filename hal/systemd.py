"""What the system's service manager is told: ready, alive (sd_notify(3), sd_watchdog_enabled(3)). Nothing elsewhere."""

from __future__ import annotations

import asyncio
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


async def alive() -> None:
    """Say that this loop is ready, and then, for as long as it is awaited, that it turns.

    On the machine's own clock; one that stands still while heavy jobs are in flight says nothing meanwhile.
    """
    notify("READY=1")
    limit_us = int(os.environ.get("WATCHDOG_USEC", "0"))
    if not limit_us or os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        await asyncio.Event().wait()
    while True:
        notify("WATCHDOG=1")
        await asyncio.sleep(1e-6 * limit_us / 4)
