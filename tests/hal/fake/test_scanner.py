"""The fake scanner: where the arm must stand, what time a capture takes, determinism, faults, halting."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted, NotConnected
from hal.fake.devices.scanner import Cloud, FakeScanner
from hal.fake.faults import Fault, FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.plant import Plant, TwinSettings
from hal.fake.scene.picture import picture_of, rotor_shape, scan_errors, shaft_shape
from hal.fake.scene.render import SceneState, render
from hal.interfaces import Frame, View
from hal.jobs import InlineJobs, ProcessJobs

POINTS = 40_000


def plant_in_view(place: str = "rotor", seed: int = 3, **overrides: float) -> Plant:
    geometry = JointGeometry(tuple(10.0 * i for i in range(36)))
    plant = Plant(geometry, TwinSettings(seed=seed, overrides=overrides))
    plant.camera = place  # type: ignore[assignment]  # one of the places
    return plant


async def inline(scene: SceneState, seed: int) -> Cloud:
    return await InlineJobs().run(render, scene, seed, latency_s=0.0)


def scanner(plant: Plant, *faults: Fault) -> FakeScanner:
    return FakeScanner(plant, FaultBook(faults), inline, points=POINTS)


def fault(kind: str, value: float | None = None, duration_s: float = 1e9) -> Fault:
    return Fault(device="scanner", kind=kind, at_s=0.0, value=value, duration_s=duration_s)


def captured(plant: Plant, *views: View, faults: tuple[Fault, ...] = ()) -> list[Frame]:
    async def main() -> list[Frame]:
        camera = scanner(plant, *faults)
        return [await camera.capture(view) for view in views]

    return run_virtual(main())


def test_a_capture_takes_about_a_second_and_ids_grow() -> None:
    async def main() -> tuple[list[Frame], float]:
        camera = scanner(plant_in_view())
        frames = [await camera.capture("rotor"), await camera.capture("artefact_rotor")]
        return frames, asyncio.get_running_loop().time()

    frames, now = run_virtual(main())
    assert [frame.frame_id for frame in frames] == [1, 2]
    assert [frame.view for frame in frames] == ["rotor", "artefact_rotor"]
    assert 1.5 < now < 4.0
    assert frames[0].points_mm.shape == (200, 200, 3)
    assert frames[0].points_mm.tobytes() != frames[1].points_mm.tobytes()


def test_same_seed_and_capture_give_the_same_cloud_in_a_worker_process_too() -> None:
    async def in_worker() -> Cloud:
        async with ProcessJobs() as jobs:

            async def there(scene: SceneState, seed: int) -> Cloud:
                return await jobs.run(render, scene, seed, latency_s=0.0)

            scene = picture_of(plant_in_view(), "rotor", POINTS)
            seed = int(plant_in_view().rng("scanner", "rotor", "1").integers(2**63))
            return await there(scene, seed)

    one, same, other = (captured(plant_in_view(seed=seed), "rotor")[0].points_mm for seed in (3, 3, 4))
    assert one.tobytes() == same.tobytes() == asyncio.run(in_worker()).tobytes()
    assert one.tobytes() != other.tobytes()


@pytest.mark.parametrize("place", ["parked", "shaft", "moving"])
def test_refused_unless_the_arm_stands_in_the_view(place: str) -> None:
    with pytest.raises(DeviceRefused, match="arm"):
        captured(plant_in_view(place), "artefact_rotor")


def test_the_camera_sees_the_truth_and_not_the_drawing() -> None:
    """A camera that really stands 0.5 mm aside sees everything 0.5 mm aside."""
    plain = captured(plant_in_view(), "rotor")[0].points_mm
    moved = captured(plant_in_view(camera_rotor_shift_z_mm=0.5), "rotor")[0].points_mm
    step = np.nanmedian(moved[..., 2].astype(np.float64) - plain[..., 2])
    assert step == pytest.approx(-0.5, abs=0.02)


def test_shapes_carry_the_true_features() -> None:
    plant = plant_in_view(hole_0_shift_x_mm=0.3)
    shaft, rotor = shaft_shape(plant), rotor_shape(plant)
    assert shaft.holes is not None
    assert rotor.studs is not None
    np.testing.assert_array_equal(shaft.holes.center_mm, plant.shaft.hole_mm)
    height = 20.0
    tip = rotor.studs.center_mm + height * rotor.studs.axis[:, :2] / rotor.studs.axis[:, 2:]
    np.testing.assert_allclose(tip, plant.rotor.stud_mm + height * plant.rotor.slope)
    np.testing.assert_allclose(shaft.holes.mouth_radius_mm - shaft.holes.radius_mm, 0.8)


def test_the_instrument_follows_the_level() -> None:
    geometry = JointGeometry(tuple(10.0 * i for i in range(36)))
    errors = {
        level: scan_errors(Plant(geometry, TwinSettings(level=level)))  # type: ignore[arg-type]  # a Level
        for level in ("ideal", "nominal", "hostile")
    }
    assert [errors[level].noise_mm for level in errors] == pytest.approx([0.005, 0.03, 0.09])
    assert [errors[level].outliers for level in errors] == pytest.approx([0.0, 0.02, 0.06])
    assert errors["ideal"].ripple_mm == errors["ideal"].scale == errors["ideal"].flying == errors["ideal"].bands == 0.0


@pytest.mark.parametrize(
    ("kind", "check"),
    [
        ("half_frame", lambda cloud: np.isnan(cloud[100:]).all() and np.isfinite(cloud[:100]).any()),
        ("all_invalid", lambda cloud: np.isnan(cloud).all()),
        ("wrong_unit", lambda cloud: 0.2 < np.nanmedian(cloud[..., 2]) < 0.5),
    ],
)
def test_spoiled_frames_come_as_data(kind: str, check: Callable[[Cloud], bool]) -> None:
    assert check(captured(plant_in_view(), "rotor", faults=(fault(kind),))[0].points_mm)


def test_an_old_frame_keeps_its_id() -> None:
    old = Fault(device="scanner", kind="old_frame", at_s=2.0, value=None, duration_s=1e9)
    first, second = captured(plant_in_view(), "rotor", "rotor", faults=(old,))
    assert second is first


@pytest.mark.parametrize(
    ("broken", "error"),
    [(fault("no_frame"), DeviceTimeout), (fault("gone"), NotConnected), (fault("hung"), DeviceTimeout)],
)
def test_no_frame_is_an_error_within_a_deadline(broken: Fault, error: type[Exception]) -> None:
    async def main() -> float:
        with pytest.raises(error):
            await scanner(plant_in_view(), broken).capture("rotor")
        return asyncio.get_running_loop().time()

    assert run_virtual(main()) < 10.0


def test_motion_during_the_exposure_is_a_fault() -> None:
    async def main() -> None:
        plant = plant_in_view("shaft")
        camera = scanner(plant)
        plant.start_move("shaft_table", 10.0, speed=5.0, acceleration=20.0, now=asyncio.get_running_loop().time())
        with pytest.raises(DeviceFault, match="moved"):
            await camera.capture("shaft")
        await asyncio.sleep(10.0)
        assert (await camera.capture("shaft")).frame_id == 1

    run_virtual(main())


def test_halt_ends_a_capture_and_the_projector_goes_dark() -> None:
    async def main() -> None:
        camera = scanner(plant_in_view())
        assert (await camera.connect()).simulated

        async def halted_after(seconds: float) -> None:
            task = asyncio.create_task(camera.capture("rotor"))
            await asyncio.sleep(seconds)
            with pytest.raises(DeviceRefused, match="in flight"):
                await camera.capture("rotor")
            await camera.halt()
            with pytest.raises(Interrupted):
                await task
            assert (await camera.safe()).safe

        task = asyncio.create_task(camera.capture("rotor"))
        await asyncio.sleep(0.1)
        assert not (await camera.safe()).safe
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert (await camera.safe()).safe
        await halted_after(0.3)
        await halted_after(1.0)
        await camera.rearm()
        assert (await camera.capture("rotor")).points_mm.shape == (200, 200, 3)
        await camera.close()

    run_virtual(main())
