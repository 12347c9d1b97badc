"""Contact force of the guns: samples in time with the feed, early end, faults."""

import asyncio
import math

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.errors import ConfigError, DeviceTimeout
from hal.fake.devices.gun_force import FakeGunForce
from hal.fake.faults import Fault, FaultBook
from hal.interfaces import ForceSensor
from tests.hal.fake.closed_joint import TIP_MM, closed_joint


def fault(kind: str, **changes: float) -> FaultBook:
    return FaultBook([Fault(device="gun_force_a", kind=kind, phase=None, **({"at_s": 0.0} | changes))])  # type: ignore[arg-type]


def test_the_names_are_the_guns() -> None:
    async def main() -> None:
        bench = await closed_joint()
        sensor: ForceSensor = FakeGunForce("gun_force_b", bench.plant, bench.faults, 100.0, 200.0)
        assert sensor.rate_hz == 100.0 and sensor.range_n == 200.0
        with pytest.raises(ConfigError):
            FakeGunForce("jack_force", bench.plant, bench.faults, 100.0, 200.0)

    run_virtual(main())


def test_a_socket_in_the_air_feels_nothing_and_blocks_take_their_time() -> None:
    async def main() -> None:
        bench = await closed_joint()
        loop = asyncio.get_running_loop()
        first = await bench.force_a.block(10)
        assert loop.time() == pytest.approx(0.09) and abs(first.samples_n).max() < 1.0
        second = await bench.force_a.block(10)
        assert second.sequence == first.sequence + 10 and second.time_s == pytest.approx(0.10)
        assert second.period_s == 0.01

    run_virtual(main())


def test_feeding_ends_with_the_first_sample_in_the_window() -> None:
    async def main() -> None:
        bench = await closed_joint()
        bench.joints.load_nut("a")
        await bench.move("gun_feed", TIP_MM - 2.0)
        start = asyncio.get_running_loop().time()
        feeding = asyncio.create_task(bench.move("gun_feed", TIP_MM + 4.0, speed=2.0))
        await asyncio.sleep(0)
        block = await bench.force_a.block(1000, high_n=8.0)
        assert len(block.samples_n) < 1000 and block.samples_n[-1] > 8.0 and (block.samples_n[:-1] <= 8.0).all()
        # 2 mm of way and 6 N on a spring of 5 N/mm at 2 mm/s.
        assert asyncio.get_running_loop().time() - start == pytest.approx((2.0 + 1.2) / 2.0, abs=0.05)
        await feeding

    run_virtual(main())


def test_samples_follow_a_motion_that_starts_while_they_are_awaited() -> None:
    async def main() -> None:
        bench = await closed_joint()
        bench.joints.load_nut("a")
        await bench.move("gun_feed", TIP_MM)
        reading = asyncio.create_task(bench.force_a.block(100))
        await asyncio.sleep(0.3)
        await bench.move("gun_feed", TIP_MM + 4.0, speed=50.0)
        samples = (await reading).samples_n
        assert samples[:29].mean() == pytest.approx(2.0, abs=0.2)
        assert samples[60:].mean() == pytest.approx(22.0, abs=0.2)

    run_virtual(main())


def test_pressing_too_hard_is_damage() -> None:
    async def main() -> None:
        bench = await closed_joint()
        bench.joints.load_nut("a")
        await bench.move("gun_feed", TIP_MM + 13.0)
        block = await bench.force_a.block(2)
        assert block.samples_n.max() == 200.0
        assert bench.plant.damages == ["gun a pressed with more than 500 N"]

    run_virtual(main())


def test_nan_ends_a_block_and_a_gap_shows_in_the_sequence() -> None:
    async def main() -> None:
        bench = await closed_joint(faults=fault("nan", at_s=0.05))
        block = await bench.force_a.block(100, high_n=10.0)
        assert math.isnan(block.samples_n[-1]) and np.isfinite(block.samples_n[:-1]).all() and len(block.samples_n) == 6
        bench = await closed_joint(faults=fault("gap"))
        first, second = await bench.force_a.block(10), await bench.force_a.block(10)
        assert second.sequence > first.sequence + 10

    run_virtual(main())


def test_a_frozen_stream_times_out() -> None:
    async def main() -> None:
        bench = await closed_joint(faults=fault("stale"))
        with pytest.raises(DeviceTimeout):
            await bench.force_a.block(10)

    run_virtual(main())
