"""The same function over many items in worker processes. Results come in the order of the items, whoever made them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import TypeVar

from hal.job_process import WorkerProcess

T = TypeVar("T")
R = TypeVar("R")

DEADLINE_S = 600.0
"""Seconds of the wall for one item."""


def map_in_processes(
    func: Callable[[T], R], items: Iterable[T], *, workers: int, modules: tuple[str, ...] = ()
) -> Iterator[R]:
    """``func(item)`` for each item in `workers` fresh processes of one numerical thread each.

    `func` is importable by name and touches nothing outside; `modules` are imported beforehand. Raises what `func`
    raised, and WorkerError where a process died or was late; all processes have ended then.
    """
    processes = [WorkerProcess(modules) for _ in range(workers)]
    idle: SimpleQueue[WorkerProcess] = SimpleQueue()
    for process in processes:
        idle.put(process)

    def one(item: T) -> R:
        process = idle.get()
        try:
            succeeded, value = process.call((func, (item,)), DEADLINE_S)
        finally:
            idle.put(process)
        if not succeeded:
            raise value.rebuilt()
        return value  # type: ignore[no-any-return]  # what func returned

    threads = ThreadPoolExecutor(max_workers=workers, thread_name_prefix="study")
    try:
        yield from threads.map(one, items)
    finally:
        # Whatever is still running, after an error or an interrupt, is of no use to anybody.
        for process in processes:
            process.interrupt()
        threads.shutdown(wait=True, cancel_futures=True)
        for process in processes:
            process.end()
