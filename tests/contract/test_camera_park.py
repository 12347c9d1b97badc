"""The contract of the camera arm."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted, SafetyOpen
from hal.fake.faults import Fault
from tests.contract.backends import Backend


def test_it_swings_from_place_to_place_and_takes_its_time(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("camera_park") as bench:
            assert (await bench.device.read()).position == "parked"
            for place in ("rotor", "shaft", "parked"):
                before = asyncio.get_running_loop().time()
                assert (await bench.device.go(place)).position == place
                assert bench.plant.camera == place
                assert asyncio.get_running_loop().time() > before + 0.5
            before = asyncio.get_running_loop().time()
            await bench.device.go("parked")
            assert asyncio.get_running_loop().time() < before + 0.5, "there already"

    backend.run(main())


def test_on_its_way_it_is_nowhere(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("camera_park") as bench:
            swing = asyncio.create_task(bench.device.go("rotor"))
            await asyncio.sleep(1.0)
            assert (await bench.device.read()).position is None
            assert not (await bench.device.safe()).safe
            await bench.device.halt()
            with pytest.raises(Interrupted):
                await swing
            assert (await bench.device.safe()).safe
            assert (await bench.device.read()).position is None
            assert (await bench.device.go("parked")).position == "parked"

    backend.run(main())


@pytest.mark.parametrize("kind", ["stuck_between", "disagree"])
def test_an_arm_that_does_not_arrive_says_so(backend: Backend, kind: str) -> None:
    async def main() -> None:
        async with backend.bench("camera_park", Fault("camera_park", kind, at_s=1.0)) as bench:
            await asyncio.sleep(2.0)
            with pytest.raises(DeviceFault):
                await bench.device.go("rotor")
            assert (await bench.device.read()).position is None

    backend.run(main())


def test_wrong_places_and_lost_power_are_refused(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("camera_park", Fault("safety", "sto_open", at_s=5.0)) as bench:
            with pytest.raises(DeviceRefused):
                await bench.device.go("roof")
            await asyncio.sleep(5.0)
            with pytest.raises(SafetyOpen):
                await bench.device.go("rotor")
            assert (await bench.device.read()).position == "parked"

    backend.run(main())


def test_an_arm_that_hangs_on_its_way_is_not_believed_to_have_arrived(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("camera_park", Fault("camera_park", "hung", at_s=1.0, duration_s=30.0)) as bench:
            with pytest.raises(DeviceTimeout):
                await bench.device.go("rotor")
            await asyncio.sleep(60.0)
            assert (await bench.device.read()).position is None

    backend.run(main())
