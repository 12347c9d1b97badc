"""The contract of a temperature channel."""

from __future__ import annotations

import asyncio
import math

import pytest

from hal.errors import NotConnected
from hal.fake.faults import Fault
from hal.interfaces import Quality
from tests.contract.backends import Backend

CHANNELS = ("spigot_tc_1", "spigot_tc_2", "pyrometer", "rotor_tc")
EVERY = pytest.mark.parametrize("name", CHANNELS)


@EVERY
def test_it_reads_the_room_in_degrees_celsius(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            readings = []
            for _ in range(10):
                readings.append(await bench.device.read())
                await asyncio.sleep(1.0)
            assert sum(reading.value for reading in readings) / 10 == pytest.approx(20.0, abs=1.5)
            assert all(reading.quality is Quality.GOOD for reading in readings)
            assert [reading.time_s for reading in readings] == sorted({reading.time_s for reading in readings})

    backend.run(main())


@EVERY
@pytest.mark.parametrize(
    ("kind", "value"), [("nan", None), ("out_of_range", 1370.0), ("stuck", None), ("drift", 2.0), ("stale", None)]
)
def test_failures_reach_the_reading(backend: Backend, name: str, kind: str, value: float | None) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, kind, at_s=10.0, value=value)) as bench:
            before = await bench.device.read()
            await asyncio.sleep(20.0)
            after = await bench.device.read()
            match kind:
                case "nan":
                    assert math.isnan(after.value)
                    assert after.quality is Quality.BAD
                case "out_of_range":
                    assert (after.value, after.quality) == (1370.0, Quality.BAD)
                case "stuck":
                    assert after.value == before.value
                    assert after.time_s > before.time_s
                case "drift":
                    assert after.value == pytest.approx(before.value + 20.0, abs=1.5)
                case "stale":
                    assert after.time_s == before.time_s

    backend.run(main())


def test_a_wrong_emissivity_shows_only_when_it_is_warm(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("pyrometer", Fault("pyrometer", "wrong_emissivity", value=0.5)) as bench:
            assert (await bench.device.read()).value == pytest.approx(20.0, abs=1.5)

    backend.run(main())


@EVERY
def test_unconnected_it_reads_nothing(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, connect=False) as bench:
            with pytest.raises(NotConnected):
                await bench.device.read()

    backend.run(main())
