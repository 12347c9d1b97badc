"""The contract of the nut feeder."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceRefused, Interrupted, SafetyOpen
from hal.fake.faults import Fault
from tests.contract.backends import COUNT, Backend


def test_it_loads_one_nut_and_counts_it(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("nut_feeder") as bench:
            full = await bench.device.count()
            assert full >= COUNT
            assert await bench.device.load("a") is True
            assert bench.plant.joints.socket_has_nut("a")
            assert not bench.plant.joints.socket_has_nut("b")
            assert await bench.device.count() == full - 1
            with pytest.raises(DeviceRefused, match="holds a nut"):
                await bench.device.load("a")
            assert await bench.device.count() == full - 1

    backend.run(main())


def test_both_guns_are_loaded_at_once(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("nut_feeder") as bench:
            assert await asyncio.gather(bench.device.load("a"), bench.device.load("b")) == [True, True]
            assert bench.plant.joints.socket_has_nut("b")

    backend.run(main())


def test_an_empty_magazine_and_a_missing_nut_are_told(backend: Backend) -> None:
    async def main() -> None:
        missing = Fault("nut_feeder", "missing_nut")
        async with backend.bench("nut_feeder", missing, Fault("nut_feeder", "empty", at_s=100.0)) as bench:
            full = await bench.device.count()
            assert await bench.device.load("a") is False
            assert not bench.plant.joints.socket_has_nut("a")
            assert await bench.device.load("a") is True
            assert await bench.device.count() == full - 1
            await asyncio.sleep(100.0)
            assert await bench.device.count() == 0
            assert await bench.device.load("b") is False

    backend.run(main())


def test_a_wrong_counter_is_wrong_by_its_error(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("nut_feeder", Fault("nut_feeder", "miscount", value=-3.0, at_s=1.0)) as bench:
            full = await bench.device.count()
            await asyncio.sleep(1.0)
            assert await bench.device.count() == full - 3

    backend.run(main())


def test_guns_must_be_back(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("nut_feeder") as bench:
            bench.plant.start_move("gun_feed", 20.0, speed=100.0, acceleration=1000.0, now=0.0)
            await asyncio.sleep(1.0)
            with pytest.raises(DeviceRefused, match="not back"):
                await bench.device.load("a")

    backend.run(main())


def test_a_halt_on_the_way_loads_nothing(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("nut_feeder", Fault("safety", "estop", at_s=50.0)) as bench:
            load = asyncio.create_task(bench.device.load("a"))
            await asyncio.sleep(0.5)
            assert not (await bench.device.safe()).safe
            await bench.device.halt()
            with pytest.raises(Interrupted):
                await load
            assert not bench.plant.joints.socket_has_nut("a")
            await asyncio.sleep(50.0)
            with pytest.raises(SafetyOpen):
                await bench.device.load("a")

    backend.run(main())


def test_new_parts_come_with_a_full_magazine(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("nut_feeder") as bench:
            full = await bench.device.count()
            await bench.device.load("a")
            bench.plant.load_parts("R-2", "S-2")
            assert await bench.device.count() == full

    backend.run(main())
