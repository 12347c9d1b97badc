"""The quickened clock: it keeps its pace, is never late in its own time, and stands still when told."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Coroutine
from typing import Any

import pytest

from hal.clock import QuickenedLoop, standing_still


def run_at(speed: float, main: Coroutine[Any, Any, None]) -> None:
    with asyncio.Runner(loop_factory=lambda: QuickenedLoop(speed)) as runner:
        runner.run(main)


def now() -> float:
    return asyncio.get_running_loop().time()


def hog(seconds: float) -> None:
    """A callback that holds the loop, as a busy machine does."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def test_it_runs_at_its_speed() -> None:
    async def main() -> None:
        wall, cell = time.perf_counter(), now()
        for _ in range(60):
            await asyncio.sleep(0.5)
        pace = (now() - cell) / (time.perf_counter() - wall)
        assert 30.0 < pace < 61.0

    run_at(60.0, main())


def test_a_callback_that_takes_long_makes_no_timer_late() -> None:
    async def main() -> None:
        late = 0.0

        async def tick() -> None:
            nonlocal late
            for _ in range(500):
                due = now() + 0.01
                await asyncio.sleep(0.01)
                late = max(late, now() - due)

        async def hold_up() -> None:
            for _ in range(5):
                await asyncio.sleep(1.0)
                hog(0.02)

        await asyncio.gather(tick(), hold_up())
        assert late < 1e-6

    run_at(60.0, main())


def test_timers_fall_due_in_their_order() -> None:
    async def main() -> None:
        seen: list[float] = []
        loop = asyncio.get_running_loop()
        start = now()
        for due in (0.3, 0.1, 0.2):
            loop.call_at(start + due, lambda: seen.append(round(now() - start, 6)))
        hog(0.02)
        await asyncio.sleep(0.4)
        assert seen == [0.1, 0.2, 0.3]

    run_at(60.0, main())


def test_no_time_passes_while_it_stands_still_and_none_is_made_up_for() -> None:
    async def main() -> None:
        before = now()
        with standing_still():
            await asyncio.get_running_loop().run_in_executor(None, hog, 0.1)
            assert now() == before
        wall = time.perf_counter()
        await asyncio.sleep(3.0)
        assert time.perf_counter() - wall > 0.03
        assert now() == pytest.approx(before + 3.0, abs=1e-6)

    run_at(60.0, main())


def test_sockets_wake_it_before_the_next_timer() -> None:
    async def main() -> None:
        ours, theirs = socket.socketpair()
        with ours, theirs:
            ours.setblocking(False)
            loop = asyncio.get_running_loop()
            start = now()
            reading = asyncio.create_task(loop.sock_recv(ours, 1))
            await asyncio.sleep(0)
            await loop.run_in_executor(None, theirs.send, b"x")
            async with asyncio.timeout(600.0):
                assert await reading == b"x"
            assert now() - start < 300.0

    run_at(60.0, main())


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_senseless_speed_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        QuickenedLoop(speed)
