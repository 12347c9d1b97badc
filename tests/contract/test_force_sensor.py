"""The contract of a streaming force sensor."""

from __future__ import annotations

import asyncio
import itertools
import math

import numpy as np
import pytest

from hal.errors import DeviceTimeout, NotConnected
from hal.fake.faults import Fault
from tests.contract.backends import Backend, Bench

SENSORS = ("jack_force", "gun_force_a", "gun_force_b")
LATE_S = 0.05
"""A sample that comes later than this is stale."""
EVERY = pytest.mark.parametrize("name", SENSORS)


def raise_shaft(bench: Bench) -> None:
    """The shaft at the rotor, where the guns have room below it."""
    bench.plant.start_move("jack", 399.0, speed=1e6, acceleration=1e9, now=asyncio.get_running_loop().time())


async def until(time_s: float) -> None:
    """Sleep until the loop's time is `time_s`."""
    await asyncio.sleep(time_s - asyncio.get_running_loop().time())


@EVERY
def test_samples_come_at_its_rate_numbered_without_a_gap(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            sensor = bench.device
            period = 1.0 / sensor.rate_hz
            first = await sensor.block(20)
            second = await sensor.block(30)
            assert (len(first.samples_n), len(second.samples_n)) == (20, 30)
            assert first.period_s == pytest.approx(period)
            assert second.sequence == first.sequence + 20
            assert second.time_s == pytest.approx(first.time_s + 20 * period, abs=period)
            newest = second.time_s + 29 * period
            assert -1e-6 <= asyncio.get_running_loop().time() - newest <= 2 * period + LATE_S
            assert np.isfinite(first.samples_n).all()

    backend.run(main())


def test_the_jack_carries_the_shaft_and_a_gun_nothing(backend: Backend) -> None:
    async def main() -> None:
        for name, force_n, tolerance_n in (("jack_force", 980.665, 20.0), ("gun_force_a", 0.0, 1.0)):
            async with backend.bench(name) as bench:
                raise_shaft(bench)
                await asyncio.sleep(1.0)
                block = await bench.device.block(100)
                assert float(block.samples_n.mean()) == pytest.approx(force_n, abs=tolerance_n)

    backend.run(main())


@EVERY
def test_it_wakes_its_reader_with_the_first_sample_outside_the_window(backend: Backend, name: str) -> None:
    async def main() -> None:
        fault = Fault(name, "out_of_range", value=150.0 if name != "jack_force" else 1900.0, at_s=1.0)
        async with backend.bench(name, fault) as bench:
            sensor = bench.device
            raise_shaft(bench)
            await until(0.9)
            await sensor.block(1)
            low, high = (-50.0, 50.0) if name != "jack_force" else (900.0, 1100.0)
            block = await sensor.block(1000, low_n=low, high_n=high)
            assert block.samples_n[-1] == fault.value
            assert ((block.samples_n[:-1] >= low) & (block.samples_n[:-1] <= high)).all()
            assert asyncio.get_running_loop().time() == pytest.approx(1.0, abs=2 / sensor.rate_hz + LATE_S)

    backend.run(main())


@EVERY
def test_not_a_number_always_wakes_it(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "nan", at_s=1.0)) as bench:
            await until(0.95)
            block = await bench.device.block(500)
            assert math.isnan(block.samples_n[-1])
            assert np.isfinite(block.samples_n[:-1]).all()
            assert asyncio.get_running_loop().time() == pytest.approx(1.0, abs=2 / bench.device.rate_hz + LATE_S)

    backend.run(main())


@EVERY
def test_a_live_signal_is_never_perfectly_still_and_a_stuck_one_is(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "stuck", at_s=1.0)) as bench:
            raise_shaft(bench)
            await asyncio.sleep(0.1)
            assert len(set((await bench.device.block(50)).samples_n.tolist())) > 10
            await asyncio.sleep(2.0)
            raise_shaft(bench)
            await asyncio.sleep(0.1)
            assert len(set((await bench.device.block(50)).samples_n.tolist()[-20:])) == 1

    backend.run(main())


@EVERY
def test_missing_samples_show_in_the_numbering(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "gap", at_s=0.5, duration_s=1.0)) as bench:
            blocks = [await bench.device.block(10)]
            while asyncio.get_running_loop().time() < 2.0:
                blocks.append(await bench.device.block(10))
            missing = [b.sequence - a.sequence - len(a.samples_n) for a, b in itertools.pairwise(blocks)]
            assert missing[:2] == [0, 0]
            assert min(missing) == 0
            assert max(missing) > 0

    backend.run(main())


@EVERY
def test_a_stream_that_stops_brings_nothing_old(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "stale", at_s=1.0)) as bench:
            await bench.device.block(10)
            await asyncio.sleep(1.5)
            with pytest.raises((TimeoutError, DeviceTimeout)):
                async with asyncio.timeout(10.0):
                    while True:
                        block = await bench.device.block(10)
                        assert block.time_s <= 1.1, "taken before the stream stopped"

    backend.run(main())


@EVERY
def test_unconnected_it_streams_nothing(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, connect=False) as bench:
            with pytest.raises(NotConnected):
                await bench.device.block(1)

    backend.run(main())
