"""The vision worker: the right camera pose for each view, the same numbers inline and in a process, refusals intact.

Where the shaft has to go is worked out there too: its forecasts would hold the controller's loop.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellctl.calibration import Calibration, load_calibration
from cellctl.docking import Alignment, align, align_spec
from cellctl.kinematics import AxesPosition
from cellctl.ports import Vision
from cellctl.recipe import load_recipe
from cellctl.vision.part import Part, PartMeasurement, Refused
from cellctl.vision.worker import VisionWorker
from hal.clock import run_virtual
from hal.fake.geometry import JointGeometry
from hal.fake.plant import Plant, TwinSettings
from hal.fake.scene.picture import picture_of
from hal.fake.scene.render import render
from hal.interfaces import Frame, View
from hal.jobs import InlineJobs, Jobs, ProcessJobs
from tests.docking import parts

POINTS = 150_000


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(JointGeometry(tuple(10.0 * i for i in range(36))), TwinSettings(seed=11))


def part(root: Path, view: str) -> Part:
    return load_recipe(root / "recipes/lpt_shaft_36.toml").part("shaft" if view == "shaft" else "rotor")


def calibration(root: Path) -> Calibration:
    return load_calibration(root / "deploy/calibration.fake.toml")


def frame(plant: Plant, view: View) -> Frame:
    return Frame(1, view, 0.0, render(picture_of(plant, view, POINTS), 5))


@pytest.mark.parametrize("view", ["rotor", "shaft"])
def test_measures_in_the_cell_frame_and_charges_its_time(root: Path, plant: Plant, view: View) -> None:
    async def main() -> tuple[PartMeasurement, float]:
        vision: Vision = VisionWorker(InlineJobs(), calibration(root), measure_s=0.8)
        measurement = await vision.measure(frame(plant, view), part(root, view))
        return measurement, asyncio.get_running_loop().time()

    measurement, now = run_virtual(main())
    assert now == pytest.approx(0.8)
    assert measurement.frame == "cell"
    assert measurement.found == 36
    true = plant.T_cell_shaft() if view == "shaft" else plant.T_cell_rotor()
    assert np.abs(measurement.T_frame_part[:3, 3] - true[:3, 3]).max() < 0.08
    assert measurement.face.normal @ true[:3, 2] > np.cos(np.radians(0.02))


@pytest.mark.parametrize("view", ["artefact_rotor", "artefact_shaft"])
def test_the_artefact_is_where_the_certificate_says(root: Path, plant: Plant, view: View) -> None:
    async def main() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return await VisionWorker(InlineJobs(), calibration(root)).artefact(frame(plant, view))

    residuals = run_virtual(main())
    assert residuals.shape == (4, 3)
    assert np.linalg.norm(residuals, axis=1).max() < 0.12


def test_a_camera_that_has_moved_shows_in_the_residuals(root: Path) -> None:
    moved = Plant(
        JointGeometry(tuple(10.0 * i for i in range(36))),
        TwinSettings(seed=11, level="ideal", overrides={"camera_shaft_shift_x_mm": 0.5}),
    )

    async def main() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return await VisionWorker(InlineJobs(), calibration(root)).artefact(frame(moved, "artefact_shaft"))

    residuals = run_virtual(main())
    # The camera really stands at +0.5 mm, so everything seems to stand at -0.5 mm.
    np.testing.assert_allclose(residuals, np.tile([-0.5, 0.0, 0.0], (4, 1)), atol=0.02)


def test_a_process_gives_the_same_numbers_and_the_same_refusal(root: Path, plant: Plant) -> None:
    seen = frame(plant, "shaft")
    empty = Frame(2, "shaft", 0.0, np.full_like(seen.points_mm, np.nan))
    metres = Frame(3, "artefact_shaft", 0.0, seen.points_mm * np.float32(1e-3))

    async def both(jobs: Jobs) -> tuple[PartMeasurement, list[tuple[str, str]]]:
        vision = VisionWorker(jobs, calibration(root))
        refused = []
        for attempt in (vision.measure(empty, part(root, "shaft")), vision.artefact(metres)):
            with pytest.raises(Refused) as refusal:
                await attempt
            refused.append((refusal.value.code, refusal.value.reason))
        return await vision.measure(seen, part(root, "shaft")), refused

    async def in_process() -> tuple[PartMeasurement, list[tuple[str, str]]]:
        async with ProcessJobs() as jobs:
            return await both(jobs)

    (here, refused_here), (there, refused_there) = run_virtual(both(InlineJobs())), asyncio.run(in_process())
    assert refused_here == refused_there
    assert refused_here[1][0] == "artefact_moved"
    np.testing.assert_array_equal(here.T_frame_part, there.T_frame_part)
    np.testing.assert_array_equal(here.covariance, there.covariance)
    assert here.quality == there.quality


HOME = AxesPosition(0.0, 0.0, 0.0, 0.0)


def both_parts() -> tuple[PartMeasurement, PartMeasurement]:
    angles = parts.recipe().pattern.angles()
    rotor = parts.measurement("stud", parts.pose(z=parts.HEIGHT, down=True), tuple(-angle for angle in angles))
    return rotor, parts.measurement("hole", parts.pose(0.4, -0.3, turn_deg=2.0), angles)


def test_an_alignment_is_a_job_that_takes_its_time() -> None:
    rotor, shaft = both_parts()
    spec = align_spec(parts.recipe())

    async def main() -> tuple[Alignment, float]:
        found = await VisionWorker(InlineJobs(), parts.calibration()).align(rotor, shaft, HOME, spec)
        return found, asyncio.get_running_loop().time()

    found, now = run_virtual(main())
    assert now == pytest.approx(0.2)
    assert found.target == align(rotor, shaft, parts.calibration(), HOME, spec).target


def test_an_alignment_comes_home_from_a_process_whole_and_so_does_its_refusal() -> None:
    rotor, shaft = both_parts()
    spec = align_spec(parts.recipe())

    async def in_process() -> tuple[Alignment, tuple[str, str]]:
        async with ProcessJobs() as jobs:
            vision = VisionWorker(jobs, parts.calibration())
            with pytest.raises(Refused) as refusal:
                await vision.align(shaft, replace(rotor, frame="input"), HOME, spec)
            return await vision.align(rotor, shaft, HOME, spec), (refusal.value.code, refusal.value.reason)

    there, refused = asyncio.run(in_process())
    here = align(rotor, shaft, parts.calibration(), HOME, spec)
    assert refused == ("frames_disagree", "the shaft was not measured in the cell frame")
    assert (there.target, there.p_insert, there.partner) == (here.target, here.p_insert, here.partner)
    np.testing.assert_array_equal(there.covariance_b, here.covariance_b)
