"""A folder, maybe on another machine, through which two programs give each other whole files.

The file system may hang, so it is only touched in one helper thread, between `open` and `close`; the loop goes on
meanwhile.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


class Folder:
    """Errors are OSError; one that hangs is TimeoutError after `deadline_s`."""

    def __init__(self, path: Path, deadline_s: float) -> None:
        self.path = path
        self._deadline_s = deadline_s
        self._thread: ThreadPoolExecutor | None = None

    def open(self) -> None:
        """Start; once started nothing happens."""
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, thread_name_prefix=f"folder {self.path.name}")

    async def close(self) -> None:
        """End the thread. One that hangs in the file system is left to end when that comes back."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        last = thread.submit(lambda: None)
        await asyncio.wait({asyncio.wrap_future(last)}, timeout=self._deadline_s)
        thread.shutdown(wait=last.done(), cancel_futures=True)

    async def put(self, name: str, data: bytes) -> None:
        """Let the file appear whole, or take the place of what was there."""
        await self._do(lambda: put_whole(self.path / name, data))

    async def get(self, name: str, largest: int) -> bytes | None:
        """Content, of which no more than `largest` bytes and one are read; None while the file is not there.

        Raises OSError where the folder is not there either.
        """
        return await self._do(lambda: self._get(name, largest))

    async def names(self) -> list[str]:
        """What lies in the folder, in order."""
        return await self._do(lambda: sorted(path.name for path in self.path.iterdir()))

    def discard(self, *names: str) -> None:
        """Take away what is there of these, some time; nobody hears how it went."""
        if self._thread is not None:
            self._thread.submit(self._remove, names)

    async def work(self, job: Callable[..., T], *args: Any) -> T:
        """A job that is too long for the loop, in the same thread."""
        return await self._do(lambda: job(*args))

    async def _do(self, job: Callable[[], T]) -> T:
        if self._thread is None:
            raise OSError(f"{self.path}: closed")
        async with asyncio.timeout(self._deadline_s):
            return await asyncio.get_running_loop().run_in_executor(self._thread, job)

    def _get(self, name: str, largest: int) -> bytes | None:
        try:
            with (self.path / name).open("rb") as file:
                return file.read(largest + 1)
        except FileNotFoundError:
            if not self.path.is_dir():
                raise
            return None

    def _remove(self, names: tuple[str, ...]) -> None:
        for name in names:
            (self.path / name).unlink(missing_ok=True)


def put_whole(path: Path, data: bytes) -> None:
    """Write beside and rename; whoever looks sees all of it or nothing."""
    beside = path.with_name(f".{path.name}.part")
    beside.write_bytes(data)
    beside.replace(path)
