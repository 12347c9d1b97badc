"""Event loops whose time is not the wall's: virtual (jumps to the next timer) and quickened (runs n times as fast).

Production code uses plain ``asyncio.sleep``, ``asyncio.timeout`` and ``loop.time()`` and cannot know which loop it
runs on. Only composition roots and tests choose one.
"""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import time
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Executor
from typing import Any, TypeVar

T = TypeVar("T")


class Deadlock(RuntimeError):
    """Under virtual time nothing is ready and no timer is set: the program would wait for ever."""


class _JumpingSelector(selectors.DefaultSelector):
    """Instead of waiting, moves the loop's clock on by what it was asked to wait."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if not ready:
            if timeout is None:
                raise Deadlock("nothing is ready and no timer is set")
            self.now += max(timeout, 0.0)
        return list(ready)


class VirtualLoop(asyncio.SelectorEventLoop):
    """Virtual time: exact, repeatable, no waiting. Executor jobs run inline; there are no real sockets here."""

    def __init__(self) -> None:
        self._selector_clock = _JumpingSelector()
        super().__init__(self._selector_clock)
        self._clock_resolution = 1e-9

    def time(self) -> float:
        return self._selector_clock.now

    def run_in_executor(  # type: ignore[override]  # inline, so that the order of events is fixed
        self, executor: Executor | None, func: Callable[..., T], *args: Any
    ) -> asyncio.Future[T]:
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future


class QuickenedLoop(asyncio.SelectorEventLoop):
    """Real sockets, but time runs `speed` times as fast, and stands still while heavy jobs are in flight."""

    def __init__(self, speed: float) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        self.speed = speed
        self._jobs = 0
        self._mark_real = time.monotonic()
        self._mark = 0.0
        inner = selectors.DefaultSelector()
        wait = inner.select

        def select(timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
            if timeout is not None and timeout > 0:
                # While time stands still no timer can fall due: only a socket or a finished job wakes the loop.
                timeout = None if self._jobs else timeout / self.speed
            return wait(timeout)

        inner.select = select  # type: ignore[method-assign]
        super().__init__(inner)

    def time(self) -> float:
        if self._jobs:
            return self._mark
        return self._mark + (time.monotonic() - self._mark_real) * self.speed

    def _set_jobs(self, jobs: int) -> None:
        self._mark = self.time()
        self._mark_real = time.monotonic()
        self._jobs = jobs

    @contextlib.contextmanager
    def standing_still(self) -> Iterator[None]:
        """Time stands still inside; used around jobs that run in worker processes."""
        self._set_jobs(self._jobs + 1)
        try:
            yield
        finally:
            self._set_jobs(self._jobs - 1)


def standing_still() -> contextlib.AbstractContextManager[None]:
    """Stop the clock of the running loop where it can be stopped; elsewhere nothing happens."""
    loop = asyncio.get_running_loop()
    return loop.standing_still() if isinstance(loop, QuickenedLoop) else contextlib.nullcontext()


def run_virtual(main: Coroutine[Any, Any, T]) -> T:
    """Run `main` under virtual time. Tasks left behind are cancelled, as asyncio.run does."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)
