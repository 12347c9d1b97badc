"""The fake load cell: what it makes of the true force, and how it predicts the samples to come."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.errors import Interrupted
from hal.fake.devices.axes import FakeAxis
from hal.fake.devices.force import FakeForceSensor
from hal.fake.faults import Fault, FaultBook
from hal.fake.plant import Plant
from hal.interfaces import AxisLimits
from tests.hal.fake.bench_plant import align, go, plant_of

WEIGHT_N = 100.0 * 9.80665


def with_sensor(
    plant: Plant,
    case: Callable[[FakeForceSensor, FakeAxis], Awaitable[None]],
    *faults: Fault,
    rate_hz: float = 1000.0,
) -> None:
    """Run `case` on a connected sensor and a jack whose drive counts as homed."""

    async def main() -> None:
        await asyncio.sleep(plant.now)
        book = FaultBook(faults)
        sensor = FakeForceSensor("jack_force", plant, book, rate_hz=rate_hz, range_n=2000.0)
        jack = FakeAxis("jack", "mm", AxisLimits(0.0, 420.0, 20.0, 50.0), plant, book)
        plant.motion["jack"].homed = True
        await sensor.connect()
        await jack.connect()
        await case(sensor, jack)
        await sensor.close()

    run_virtual(main())


def now() -> float:
    return asyncio.get_running_loop().time()


def test_the_stream_is_the_same_however_it_is_read() -> None:
    def stream(sizes: list[int]) -> np.ndarray:
        parts: list[np.ndarray] = []

        async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
            move = asyncio.create_task(jack.move_to(20.0, speed=10.0))
            for size in sizes:
                block = await sensor.block(size)
                assert block.sequence == sum(len(part) for part in parts)
                parts.append(block.samples_n)
            await move

        with_sensor(plant_of(seed=3), case)
        return np.concatenate(parts)

    assert (stream([10] * 250) == stream([2500])).all()
    assert (stream([1, 999, 7, 1493]) == stream([2500])).all()


def test_noise_gain_and_creep_are_those_of_the_truth() -> None:
    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        block = await sensor.block(5000)
        gain = plant.cell.force_gain
        assert np.std(block.samples_n) == pytest.approx(0.1, rel=0.1)
        assert np.mean(block.samples_n) == pytest.approx(gain * plant.shaft.mass_kg * 9.80665 + 20.0, abs=3.0)
        await asyncio.sleep(3000.0)
        later = await sensor.block(5000)
        creep = np.mean(later.samples_n) - np.mean(block.samples_n)
        assert creep == pytest.approx(0.0002 * gain * plant.shaft.mass_kg * 9.80665, rel=0.1)

    plant = plant_of(overrides={"force_gain": 1.1, "force_offset_n": 20.0})
    with_sensor(plant, case)


def test_beyond_the_range_it_saturates() -> None:
    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        assert (await sensor.block(10)).samples_n == pytest.approx(np.full(10, 2000.0))

    with_sensor(plant_of("ideal", overrides={"shaft_mass_kg": 300.0}), case)


def test_the_filter_delays_what_the_jack_does() -> None:
    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        await sensor.block(100)
        move = asyncio.create_task(jack.move_to(20.0, speed=10.0))
        block = await sensor.block(100)
        late = int(np.argmax(block.samples_n > WEIGHT_N + 2.0))
        assert late * block.period_s == pytest.approx(0.005, abs=0.0011)
        await move

    with_sensor(plant_of("ideal", overrides={"force_delay_s": 0.005, "force_noise_n": 0.0}), case)


def touching(x_mm: float = 0.5, height_mm: float = 368.0) -> Plant:
    """A shaft that stands just below the point where its studs meet the chamfers."""
    plant = plant_of("ideal", overrides={"force_noise_n": 0.0})
    align(plant, x_mm=x_mm)
    go(plant, "jack", height_mm)
    return plant


def test_the_reader_is_woken_by_the_very_sample_that_leaves_the_window() -> None:
    plant = touching()

    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        move = asyncio.create_task(jack.move_to(371.0, speed=0.2))
        await asyncio.sleep(0.5)
        block = await sensor.block(20_000, low_n=WEIGHT_N - 20.0, high_n=WEIGHT_N + 5.0)
        assert now() == pytest.approx(block.time_s + (len(block.samples_n) - 1) * block.period_s, abs=1e-6)
        assert (block.samples_n[:-1] <= WEIGHT_N + 5.0).all()
        assert WEIGHT_N + 5.0 < block.samples_n[-1] < WEIGHT_N + 6.0
        await jack.halt()
        with pytest.raises(Interrupted):
            await move

    with_sensor(plant, case)


def test_a_changed_motion_changes_the_samples_to_come() -> None:
    plant = touching()

    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        move = asyncio.create_task(jack.move_to(371.0, speed=0.2))
        reading = asyncio.create_task(sensor.block(8000))
        await asyncio.sleep(4.0)
        await jack.halt()
        with contextlib.suppress(Interrupted):
            await move
        block = await reading
        assert len(block.samples_n) == 8000
        assert block.samples_n[6000:].max() - block.samples_n[6000:].min() < 1e-6
        standing = float(plant.jack_force_n(np.array([plant.now]))[0])
        assert block.samples_n[-1] == pytest.approx(standing, abs=1.0)

    with_sensor(plant, case)


@pytest.mark.parametrize("x_mm", [0.3, 0.6, 1.0])
def test_a_trip_in_creep_stops_the_jack_below_ten_newton(x_mm: float) -> None:
    """F_limit - k v (delays) - v sqrt(k m) of the design book leaves 4.5 N at 0.2 mm/s."""
    plant = touching(x_mm)

    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        move = asyncio.create_task(jack.move_to(371.0, speed=0.2))
        await asyncio.sleep(0.5)
        while len((await sensor.block(10, high_n=WEIGHT_N + 4.5)).samples_n) == 10:
            pass
        await asyncio.sleep(0.002)
        await jack.halt()
        with pytest.raises(Interrupted):
            await move
        await asyncio.sleep(1.0)
        plant.advance(now())
        assert 4.5 < plant.engagement.peak_total_n < 10.0
        assert plant.engagement.peak_n.max() < 10.0

    with_sensor(plant, case)


def test_a_late_reader_gets_the_buffer_and_a_very_late_one_only_what_is_new() -> None:
    async def case(sensor: FakeForceSensor, jack: FakeAxis) -> None:
        first = await sensor.block(10)
        await asyncio.sleep(0.05)
        buffered = await sensor.block(10)
        assert buffered.sequence == first.sequence + 10
        await asyncio.sleep(5.0)
        fresh = await sensor.block(10)
        assert fresh.time_s == pytest.approx(now() - 0.009, abs=0.0015)

    with_sensor(plant_of(), case)


def test_a_fault_of_a_phase_entered_later_reaches_the_samples_computed_ahead() -> None:
    plant = plant_of()

    async def main() -> None:
        book = FaultBook((Fault("jack_force", "nan", phase="jack_up"),))
        sensor = FakeForceSensor("jack_force", plant, book, rate_hz=1000.0, range_n=2000.0)
        await sensor.connect()
        assert np.isfinite((await sensor.block(10)).samples_n).all()
        book.enter_phase("jack_up", now())
        assert math.isnan((await sensor.block(10)).samples_n[-1])
        await sensor.close()

    run_virtual(main())
