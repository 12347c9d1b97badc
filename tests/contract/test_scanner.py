"""The contract of the structured-light camera."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from hal.errors import DeviceRefused, DeviceTimeout, Interrupted
from hal.fake.faults import Fault
from tests.contract.backends import Backend


def test_each_capture_is_a_new_organised_frame_of_its_view(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("scanner") as bench:
            bench.plant.camera = "shaft"
            first = await bench.device.capture("shaft")
            second = await bench.device.capture("artefact_shaft")
            assert (first.view, second.view) == ("shaft", "artefact_shaft")
            assert second.frame_id > first.frame_id
            assert first.points_mm.ndim == 3
            assert first.points_mm.shape[2] == 3
            assert first.points_mm.dtype == np.float32
            assert 0.0 < first.time_s < second.time_s
            assert asyncio.get_running_loop().time() > 0.5, "a capture takes its time"

    backend.run(main())


def test_the_same_seed_and_capture_give_the_same_cloud(backend: Backend) -> None:
    async def main() -> None:
        clouds = []
        for _ in range(2):
            async with backend.bench("scanner") as bench:
                bench.plant.camera = "rotor"
                clouds.append((await bench.device.capture("rotor")).points_mm)
        assert np.array_equal(*clouds)

    backend.run(main())


def test_it_takes_no_picture_of_what_it_does_not_look_at(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("scanner") as bench:
            for place in ("parked", "moving", "rotor"):
                bench.plant.camera = place
                with pytest.raises(DeviceRefused):
                    await bench.device.capture("shaft")

    backend.run(main())


def test_a_halt_ends_the_exposure(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("scanner") as bench:
            bench.plant.camera = "shaft"
            capture = asyncio.create_task(bench.device.capture("shaft"))
            await asyncio.sleep(0.2)
            assert not (await bench.device.safe()).safe
            with pytest.raises(DeviceRefused):
                await bench.device.capture("shaft")
            await bench.device.halt()
            with pytest.raises(Interrupted):
                await capture
            assert (await bench.device.safe()).safe

    backend.run(main())


@pytest.mark.parametrize("kind", ["no_frame", "half_frame", "all_invalid", "wrong_unit", "old_frame"])
def test_how_it_fails(backend: Backend, kind: str) -> None:
    async def main() -> None:
        async with backend.bench("scanner", Fault("scanner", kind, at_s=20.0)) as bench:
            bench.plant.camera = "shaft"
            good = await bench.device.capture("shaft")
            await asyncio.sleep(20.0)
            if kind == "no_frame":
                with pytest.raises(DeviceTimeout):
                    await bench.device.capture("shaft")
                return
            frame = await bench.device.capture("shaft")
            valid = np.isfinite(frame.points_mm).all(axis=2)
            match kind:
                case "half_frame":
                    assert 0.3 < valid.mean() < 0.7
                case "all_invalid":
                    assert not valid.any()
                case "wrong_unit":
                    assert np.nanmax(np.abs(frame.points_mm)) < 1.5
                case _:
                    assert frame.frame_id == good.frame_id

    backend.run(main())
