"""Event loops whose time is not the wall's: virtual (jumps to the next timer) and quickened (runs n times as fast).

Production code uses plain ``asyncio.sleep``, ``asyncio.timeout`` and ``loop.time()`` and cannot know which loop it
runs on. Only composition roots and tests choose one.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
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
        if timeout is not None:  # nothing outside the loop can bring an event: the system need not be asked
            self.now += max(timeout, 0.0)
            return []
        if ready := super().select(0):
            return list(ready)
        raise Deadlock("nothing is ready and no timer is set")


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


class _PacedSelector(selectors.DefaultSelector):
    """Moves the loop's clock on while the loop waits, never past the next timer, never while a callback runs.

    So a callback that takes long, or a busy machine, makes nothing late in the loop's own time; the clock falls behind
    the wall instead and catches up, by no more than `CATCH_UP_S` of the wall.
    """

    CATCH_UP_S = 0.25

    def __init__(self, speed: float, catch_up_s: float | None = None) -> None:
        super().__init__()
        self.speed = speed
        self._most = self.CATCH_UP_S * speed if catch_up_s is None else catch_up_s
        self.now = 0.0
        self.jobs = 0
        self._behind = 0.0
        self._mark = time.monotonic()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if self.jobs:
            # While time stands still no timer can fall due: only a socket or a finished job wakes the loop.
            ready = super().select(timeout if timeout is not None and timeout <= 0 else None)
            self.forget()
            return ready
        if timeout is not None and timeout <= 0:
            return super().select(0)
        self._look()
        wait = None if timeout is None else max(timeout - self._behind, 0.0) / self.speed
        ready = super().select(wait)
        self._look()
        step = self._behind if timeout is None or ready else timeout
        step = step if timeout is None else min(step, timeout)
        self.now += step
        self._behind = max(self._behind - step, 0.0)
        return ready

    def forget(self) -> None:
        """What the wall's clock did up to now counts for nothing."""
        self._mark = time.monotonic()
        self._behind = 0.0

    def _look(self) -> None:
        now = time.monotonic()
        self._behind = min(self._behind + (now - self._mark) * self.speed, self._most)
        self._mark = now


class QuickenedLoop(asyncio.SelectorEventLoop):
    """Real sockets, but time runs up to `speed` times as fast, and stands still while heavy jobs are in flight.

    For fakes only: between two waits of the loop no time passes, however long callbacks take.
    """

    def __init__(self, speed: float, catch_up_s: float | None = None) -> None:
        """`catch_up_s`: the most loop time by which the clock may be behind; by default a quarter of a second of the
        wall. With little of it time hardly passes while sockets are busy."""
        self.speed = speed
        self._paced = _PacedSelector(speed, catch_up_s)
        super().__init__(self._paced)
        self._clock_resolution = 1e-9
        if not (speed > 0 and math.isfinite(speed)):
            self.close()  # a loop that is half made complains when it is collected
            raise ValueError(f"speed must be positive, got {speed}")

    def time(self) -> float:
        return self._paced.now

    @contextlib.contextmanager
    def standing_still(self) -> Iterator[None]:
        """Time stands still inside; used around jobs that run in worker processes."""
        self._paced.jobs += 1
        try:
            yield
        finally:
            self._paced.jobs -= 1
            self._paced.forget()


def standing_still() -> contextlib.AbstractContextManager[None]:
    """Stop the clock of the running loop where it can be stopped; elsewhere nothing happens."""
    loop = asyncio.get_running_loop()
    return loop.standing_still() if isinstance(loop, QuickenedLoop) else contextlib.nullcontext()


def run_virtual(main: Coroutine[Any, Any, T]) -> T:
    """Run `main` under virtual time. Tasks left behind are cancelled, as asyncio.run does."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)
