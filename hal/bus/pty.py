"""The device's end of a serial line: a pseudo-terminal behind a link of fixed name, as udev gives to an adapter."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from collections.abc import Callable
from pathlib import Path

READ = 65536


class Pty:
    """Unplugged at first. Bytes of the host go to `on_bytes`; what it does not read in time is lost, as on a wire."""

    def __init__(self, path: Path, on_bytes: Callable[[bytes], None]) -> None:
        self.path = path
        self.lost = 0
        """Bytes that found no room."""
        self._on_bytes = on_bytes
        self._ends: tuple[int, int] | None = None

    @property
    def plugged(self) -> bool:
        """Whether `path` leads anywhere."""
        return self._ends is not None

    def plug(self) -> None:
        """Appear at `path`, with another terminal behind it each time."""
        if self._ends is not None:
            return
        master, slave = os.openpty()
        # The host's end stays open here too, or this end would read as hung up until a host comes.
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._ends = master, slave
        asyncio.get_running_loop().add_reader(master, self._read, master)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))

    def unplug(self) -> None:
        """The host's port is gone."""
        if self._ends is None:
            return
        self.path.unlink(missing_ok=True)
        asyncio.get_running_loop().remove_reader(self._ends[0])
        for end in self._ends:
            os.close(end)
        self._ends = None

    def write(self, data: bytes) -> None:
        """Send; nothing is sent while unplugged."""
        if self._ends is None:
            return
        written = 0
        with contextlib.suppress(BlockingIOError):
            written = os.write(self._ends[0], data)
        self.lost += len(data) - written

    def _read(self, master: int) -> None:
        with contextlib.suppress(BlockingIOError):
            self._on_bytes(os.read(master, READ))
