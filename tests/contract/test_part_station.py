"""The contract of the part station."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceFault, DeviceRefused
from hal.fake.faults import Fault
from tests.contract.backends import Backend


def test_the_ordered_parts_come_in_unclamped(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("part_station", level="nominal") as bench:
            before = bench.plant.shaft
            assert await bench.device.present("R-7", "S-7") == ("R-7", "S-7")
            first = bench.plant.shaft
            assert first is not before
            assert not bench.plant.chuck_clamped
            assert asyncio.get_running_loop().time() > 1.0
            await bench.device.present("R-7", "S-8")
            assert bench.plant.shaft.T_chuck_shaft.tolist() != first.T_chuck_shaft.tolist()
            await bench.device.present("R-7", "S-7")
            assert bench.plant.shaft.T_chuck_shaft.tolist() == first.T_chuck_shaft.tolist(), "same serial, same part"

    backend.run(main())


def test_another_part_is_told_by_its_serial_number(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("part_station", Fault("part_station", "wrong_serial")) as bench:
            rotor, shaft = await bench.device.present("R-7", "S-7")
            assert rotor == "R-7"
            assert shaft != "S-7"

    backend.run(main())


def test_an_unreadable_code_is_a_fault(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("part_station", Fault("part_station", "unreadable")) as bench:
            with pytest.raises(DeviceFault, match="serial"):
                await bench.device.present("R-7", "S-7")

    backend.run(main())


def test_parts_go_in_only_with_the_jack_down(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("part_station") as bench:
            bench.plant.start_move("jack", 50.0, speed=100.0, acceleration=1000.0, now=0.0)
            await asyncio.sleep(2.0)
            shaft = bench.plant.shaft
            with pytest.raises(DeviceRefused, match="jack"):
                await bench.device.present("R-7", "S-7")
            assert bench.plant.shaft is shaft

    backend.run(main())
