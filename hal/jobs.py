"""Heavy work (vision, scene rendering) that must not hold the event loop: inline under virtual time, else in a process.

A job is a function importable by name and arguments that can be pickled; large arrays travel through shared memory.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from hal.clock import standing_still
from hal.errors import WorkerError
from hal.job_process import WorkerProcess

T = TypeVar("T")


class Jobs(Protocol):
    """Runs functions somewhere else."""

    async def run(self, func: Callable[..., T], *args: Any, latency_s: float) -> T:
        """`func(*args)`, delivered after `latency_s` of cell time. What it raises is raised here.

        Raises WorkerError where the worker died or missed its deadline: nothing came of the job, which has no effects.
        """
        ...


class InlineJobs:
    """Under virtual time: runs at once in this process; the cell's clock is charged `latency_s`."""

    async def run(self, func: Callable[..., T], *args: Any, latency_s: float) -> T:
        """See `Jobs.run`."""
        try:
            return func(*args)
        finally:
            await asyncio.sleep(latency_s)


class ProcessJobs:
    """One worker process at low priority, and a warm spare that takes over when it dies, is late or is interrupted.

    Jobs run one after the other. While one is in flight a quickened clock stands still, unless `stops_clock` is false
    (for work that is no part of what the cell does); `deadline_s` is wall time.
    `modules` are imported before the first job comes. Use it as ``async with``, or `start` and `close` it.
    """

    def __init__(self, *, deadline_s: float = 60.0, modules: tuple[str, ...] = (), stops_clock: bool = True) -> None:
        self._deadline_s = deadline_s
        self._stops_clock = stops_clock
        self._modules = modules
        self._turn = asyncio.Lock()
        # One thread does everything that blocks, so that workers are never touched from two sides.
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="jobs")
        self._workers: list[WorkerProcess] = []
        self._closed = False

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def worker_pids(self) -> tuple[int, ...]:
        """Process ids of worker and spare, for health and tests."""
        return tuple(worker.pid for worker in self._workers)

    async def start(self) -> None:
        """Start worker and spare; returns before they are warm."""
        await self._in_thread(self._fill)

    async def close(self) -> None:
        """End worker and spare; a job in flight fails with WorkerError. May be called twice."""
        if self._closed:
            return
        self._closed = True
        for worker in self._workers[:1]:
            worker.interrupt()
        await self._in_thread(self._end_all)
        self._thread.shutdown()

    async def run(self, func: Callable[..., T], *args: Any, latency_s: float) -> T:
        """See `Jobs.run`. A cancelled job is killed with its worker, so that it holds up no other."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        with standing_still() if self._stops_clock else nullcontext():
            async with self._turn:
                if self._closed:
                    raise WorkerError("the workers are closed")
                succeeded, value = await self._in_thread(self._exchange, (func, args))
        await asyncio.sleep(max(begun_s + latency_s - loop.time(), 0.0))
        if not succeeded:
            raise value.rebuilt()
        return value  # type: ignore[no-any-return]  # what func returned

    async def _in_thread(self, func: Callable[..., T], *args: Any) -> T:
        """Run to the end even when the caller is cancelled, which interrupts a job in flight."""
        future = asyncio.get_running_loop().run_in_executor(self._thread, func, *args)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            for worker in self._workers[:1]:
                worker.interrupt()
            await asyncio.wait([future])
            if not future.cancelled():
                future.exception()
            raise

    def _exchange(self, job: object) -> tuple[bool, Any]:
        self._fill()
        try:
            return self._workers[0].call(job, self._deadline_s)
        finally:
            self._fill()

    def _fill(self) -> None:
        """Replace the dead; the spare moves up."""
        for worker in [worker for worker in self._workers if worker.dead]:
            worker.end()
            self._workers.remove(worker)
        while len(self._workers) < 2 and not self._closed:
            self._workers.append(WorkerProcess(self._modules))

    def _end_all(self) -> None:
        for worker in self._workers:
            worker.end()
        self._workers.clear()
