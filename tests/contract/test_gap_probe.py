"""The contract of a gap probe."""

from __future__ import annotations

import asyncio
import math

import pytest

from hal.errors import NotConnected
from hal.fake.faults import Fault
from hal.interfaces import Quality
from tests.contract.backends import Backend, Bench

PROBES = ("gap_probe_1", "gap_probe_2", "gap_probe_3")


def raise_to_gap(bench: Bench, gap_mm: float) -> None:
    """Bring the faces to `gap_mm` apart in no time."""
    now = asyncio.get_running_loop().time()
    bench.plant.start_move("jack", 400.0 - gap_mm, speed=1e6, acceleration=1e9, now=now)


@pytest.mark.parametrize("name", PROBES)
@pytest.mark.parametrize("gap_mm", [0.02, 0.5, 1.9])
def test_it_measures_the_gap_in_millimetres(backend: Backend, name: str, gap_mm: float) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            raise_to_gap(bench, gap_mm)
            await asyncio.sleep(1.0)
            readings = [await bench.device.read() for _ in range(20)]
            mean = sum(reading.value for reading in readings) / len(readings)
            assert mean == pytest.approx(gap_mm, abs=0.002)
            assert len({reading.value for reading in readings}) > 1, "a real probe is never perfectly still"
            assert readings[0].quality is Quality.GOOD
            last = await bench.device.read()
            assert last.time_s == pytest.approx(asyncio.get_running_loop().time(), abs=0.1)

    backend.run(main())


def test_beyond_its_range_it_says_so(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("gap_probe_1") as bench:
            assert (await bench.device.read()).quality is Quality.BAD
            raise_to_gap(bench, 2.1)
            await asyncio.sleep(1.0)
            reading = await bench.device.read()
            assert reading.quality is Quality.BAD
            assert reading.value == 2.0

    backend.run(main())


def test_failures_reach_the_reading(backend: Backend) -> None:
    async def main(kind: str, value: float | None = None) -> None:
        async with backend.bench("gap_probe_2", Fault("gap_probe_2", kind, at_s=10.0, value=value)) as bench:
            raise_to_gap(bench, 0.5)
            await asyncio.sleep(5.0)
            before = await bench.device.read()
            raise_to_gap(bench, 0.1)
            await asyncio.sleep(7.0)
            after = await bench.device.read()
            match kind:
                case "nan":
                    assert math.isnan(after.value)
                    assert after.quality is Quality.BAD
                case "out_of_range":
                    assert after.quality is Quality.BAD
                case "stuck":
                    assert after.value == before.value
                case "drift":
                    assert after.value == pytest.approx(0.1 + 2 * 0.01, abs=0.005)
                case "stale":
                    assert after.time_s == before.time_s

    for kind, value in (("nan", None), ("out_of_range", 3.0), ("stuck", None), ("drift", 0.01), ("stale", None)):
        backend.run(main(kind, value))


def test_unconnected_it_reads_nothing(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("gap_probe_3", connect=False) as bench:
            with pytest.raises(NotConnected):
                await bench.device.read()

    backend.run(main())
