"""A camera in a worker process: calls with a deadline on the loop, which a hanging or crashing producer never holds up.

One call runs at a time. One that is late is ended with its process; the next call starts another one, where the camera
has to be opened anew.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from hal.clock import standing_still
from hal.errors import WorkerError
from hal.job_process import WorkerProcess

T = TypeVar("T")
NEVER_S = 3600.0
"""Deadlines are the loop's; the process is ended when one has passed."""


class CameraProcess:
    """Functions are those of `hal.bus.camera`."""

    def __init__(self) -> None:
        self._thread: ThreadPoolExecutor | None = None
        self._worker: WorkerProcess | None = None
        self._turn = asyncio.Lock()

    @property
    def pid(self) -> int | None:
        """Process id, where one runs."""
        return None if self._worker is None or self._worker.dead else self._worker.pid

    async def start(self) -> None:
        """Have a process, if there is none; a new one is warm when this returns."""
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, thread_name_prefix="camera")
        async with self._turn:
            if self.pid is None:
                self._end(self._thread)
                self._worker = WorkerProcess(("hal.bus.camera_socket",))
                with standing_still():
                    await self._in_thread(self._worker, _nothing)

    async def call(self, deadline_s: float, function: Callable[..., T], *args: Any) -> T:
        """`function(*args)` there. What it raises is raised here.

        Raises TimeoutError (late: the process has been ended), WorkerError (none runs, or it died).
        """
        try:
            async with asyncio.timeout(deadline_s):
                async with self._turn:
                    worker = self._worker
                    if worker is None or worker.dead:
                        raise WorkerError("no camera process runs")
                    return await self._in_thread(worker, function, *args)
        except TimeoutError:
            if self._thread is not None:
                self._end(self._thread)
            raise

    async def close(self) -> None:
        """End the process and the thread, whatever hangs."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._end(thread)
            await asyncio.get_running_loop().run_in_executor(thread, _nothing)
            thread.shutdown()

    def _end(self, thread: ThreadPoolExecutor) -> None:
        """Kill the process; it is reaped once the exchange in flight has failed for that."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.interrupt()
            thread.submit(worker.end)

    async def _in_thread(self, worker: WorkerProcess, function: Callable[..., T], *args: Any) -> T:
        """One exchange, to its end even where nobody waits for it any more: what comes next waits for it."""
        assert self._thread is not None
        loop = asyncio.get_running_loop()
        future = loop.run_in_executor(self._thread, worker.call, (function, args), NEVER_S)
        future.add_done_callback(lambda done: done.cancelled() or done.exception())
        succeeded, value = await asyncio.shield(future)
        if not succeeded:
            raise value.rebuilt()
        return value  # type: ignore[no-any-return]  # what the function returned


def _nothing() -> None:
    """What proves that a process has started."""
