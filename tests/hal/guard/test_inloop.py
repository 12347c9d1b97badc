"""The force guard as a task: what it stops, what it latches, what it leaves behind."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.errors import GuardTripped, ImplausibleReading, NotConnected
from hal.guard.inloop import InLoopGuard
from hal.interfaces import GuardLimits
from hal.latch import Latch
from tests.hal.small import SmallAxis, SmallForce

LIMITS = GuardLimits("insert", tare_n=1000.0, trip_n=5.0, low_n=-50.0, stale_ms=50.0, block=10)


class Bench:
    """A guard on a small sensor and two axes."""

    def __init__(self) -> None:
        self.sensor = SmallForce()
        self.axes = [SmallAxis("jack"), SmallAxis("gun_feed")]
        self.latch = Latch()
        self.guard = InLoopGuard(
            self.sensor,
            self.axes,
            self.latch,
            idle_block=500,
            idle_stale_s=0.05,
            halt_deadline_s=0.1,
            frozen_samples=200,
        )

    @property
    def jack(self) -> SmallAxis:
        return self.axes[0]

    async def tripped(self, within_s: float = 1.0) -> float:
        """Loop time at which the latch closed."""
        loop = asyncio.get_running_loop()
        end = loop.time() + within_s
        while not self.latch.closed:
            assert loop.time() < end, "no trip"
            await asyncio.sleep(0.0005)
        return loop.time()


def run(main: Coroutine[Any, Any, None]) -> None:
    async def whole() -> None:
        await main
        assert len(asyncio.all_tasks()) == 1, "a task was left"

    run_virtual(whole())


def test_over_force_halts_every_axis_within_one_sample_and_latches() -> None:
    async def main() -> None:
        bench = Bench()
        bench.sensor.script = {57: 1007.0}
        move = asyncio.create_task(bench.jack.move_to(100.0, speed=1.0))
        await bench.guard.arm(LIMITS)
        at = await bench.tripped()
        assert at == pytest.approx(0.058, abs=0.0011)
        with pytest.raises(Exception, match="halted"):
            await move
        assert [axis.halts for axis in bench.axes] == [1, 1]
        state = await bench.guard.disarm()
        assert state.tripped
        assert not state.armed
        assert state.peak_n == pytest.approx(7.0)
        assert "7.00 N above 5.00 N" in state.reason

    run(main())


def test_only_rearm_clears_the_latch() -> None:
    async def main() -> None:
        bench = Bench()
        bench.sensor.script = {5: float("nan")}
        await bench.guard.arm(LIMITS)
        assert bench.guard.state().tripped
        assert (await bench.guard.disarm()).tripped
        with pytest.raises(GuardTripped, match="latched"):
            await bench.guard.arm(LIMITS)
        assert isinstance(bench.latch.refusal("jack"), GuardTripped)
        await bench.guard.rearm()
        assert not bench.guard.state().tripped
        assert bench.latch.refusal("jack") is None
        await bench.guard.arm(LIMITS)
        await asyncio.sleep(0.1)
        state = await bench.guard.disarm()
        assert not state.tripped
        assert state.samples >= 100

    run(main())


def test_arming_proves_a_living_sensor_first() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.guard.arm(LIMITS)
        assert bench.guard.state().samples == 10
        await bench.guard.disarm()
        bench.sensor.silent = True
        await bench.guard.arm(LIMITS)
        state = bench.guard.state()
        assert state.tripped
        assert "silent" in state.reason
        await bench.guard.disarm()

    run(main())


def test_samples_that_the_link_kept_from_before_are_let_go() -> None:
    async def main() -> None:
        bench = Bench()
        bench.sensor.kept = 80
        await asyncio.sleep(0.2)
        await bench.guard.arm(LIMITS)
        assert bench.guard.state().samples == 10
        assert not bench.guard.state().tripped
        await bench.guard.disarm()
        bench.sensor.kept = 80
        before = asyncio.get_running_loop().time()
        window = await bench.guard.window(0.1)
        assert window.time_s >= before
        assert len(window.samples_n) == 100

    run(main())


def test_a_sensor_whose_samples_stay_old_trips_at_arming() -> None:
    async def main() -> None:
        bench = Bench()
        bench.sensor.late_s = 5.0
        await asyncio.sleep(10.0)
        await bench.guard.arm(LIMITS)
        assert "ms old" in bench.guard.state().reason
        await bench.guard.disarm()

    run(main())


def test_a_sensor_that_dies_latches_in_time() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.guard.arm(LIMITS)
        bench.sensor.silent = True
        before = asyncio.get_running_loop().time()
        assert await bench.tripped() - before <= 0.010 + 0.010 + 0.050 + 0.001
        await bench.guard.disarm()
        assert bench.jack.halts == 1

    run(main())


@pytest.mark.parametrize("fault", ["gone", "gap", "stale", "frozen", "broken"])
def test_whatever_is_wrong_with_the_stream_latches(fault: str) -> None:
    async def main() -> None:
        bench = Bench()
        await bench.guard.arm(LIMITS)
        match fault:
            case "gone":
                bench.sensor.error = NotConnected("cable", device="jack_force")
            case "gap":
                bench.sensor.skip = 3
            case "frozen":
                bench.sensor.frozen = True
            case "stale":
                bench.sensor.late_s = 0.2
            case _:
                bench.sensor.error = RuntimeError("a bug in the driver")
        await bench.tripped()
        assert (await bench.guard.disarm()).tripped

    run(main())


def test_windows_are_read_idle_and_armed_without_a_gap() -> None:
    async def main() -> None:
        bench = Bench()
        idle = await bench.guard.window(1.0)
        assert len(idle.samples_n) == 1000
        assert len(asyncio.all_tasks()) == 1
        bench.sensor.script = {n: 1000.0 + (n % 5) for n in range(1000, 5000)}
        await bench.guard.arm(LIMITS)
        first, second = await asyncio.gather(bench.guard.window(0.1), bench.guard.window(0.25))
        assert [len(first.samples_n), len(second.samples_n)] == [100, 250]
        expected = 1000.0 + (first.sequence + np.arange(250)) % 5
        assert second.samples_n.tolist() == expected.tolist()
        assert bench.guard.state().armed
        await bench.guard.disarm()

    run(main())


def test_arming_during_an_idle_window_keeps_the_window_whole() -> None:
    async def main() -> None:
        bench = Bench()
        window = asyncio.create_task(bench.guard.window(0.8))
        await asyncio.sleep(0.1)
        await bench.guard.arm(LIMITS)
        assert len((await window).samples_n) == 800
        state = await bench.guard.disarm()
        assert not state.tripped

    run(main())


def test_a_frozen_sensor_is_noticed_in_an_idle_window_too() -> None:
    async def main() -> None:
        bench = Bench()
        bench.sensor.frozen = True
        with pytest.raises(GuardTripped, match="frozen"):
            await bench.guard.window(1.0)
        assert bench.latch.closed

    run(main())


def test_a_trip_ends_open_windows_with_its_reason() -> None:
    async def main() -> None:
        bench = Bench()
        bench.sensor.script = {50: 1100.0}
        await bench.guard.arm(LIMITS)
        with pytest.raises(GuardTripped, match="above"):
            await bench.guard.window(1.0)
        await bench.guard.disarm()

    run(main())


def test_a_hung_axis_does_not_hold_up_the_others() -> None:
    async def main() -> None:
        bench = Bench()
        jack, feed = bench.axes
        jack.hang = True
        bench.sensor.script = {5: 2000.0}
        move = asyncio.create_task(feed.move_to(100.0, speed=1.0))
        await bench.guard.arm(LIMITS)
        state = await bench.guard.disarm()
        assert "jack did not acknowledge" in state.reason
        with pytest.raises(Exception, match="halted"):
            await move
        assert asyncio.get_running_loop().time() < 0.25

    run(main())


def test_disarm_and_arm_at_once_still_watches() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.guard.arm(LIMITS)
        await asyncio.gather(bench.guard.disarm(), bench.guard.arm(LIMITS))
        bench.sensor.script = {bench.sensor.sequence + 30: 1100.0}
        assert bench.guard.state().armed
        await bench.tripped()
        await bench.guard.disarm()

    run(main())


def test_close_leaves_no_task_and_ends_windows() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.guard.arm(LIMITS)
        window = asyncio.create_task(bench.guard.window(10.0))
        await asyncio.sleep(0.05)
        await bench.guard.close()
        with pytest.raises(ImplausibleReading, match="closed"):
            await window

    run(main())


def test_limits_that_nothing_can_keep_are_refused() -> None:
    async def main() -> None:
        bench = Bench()
        with pytest.raises(ImplausibleReading):
            await bench.guard.arm(GuardLimits("x", float("nan"), 5.0, -5.0, 50.0, 10))
        with pytest.raises(ImplausibleReading):
            await bench.guard.arm(GuardLimits("x", 0.0, -5.0, 5.0, 50.0, 10))

    run(main())
