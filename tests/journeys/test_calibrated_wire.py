"""Calibration over the devices' own protocols: what is found agrees with the truth of the plant behind the wires."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cellctl.calibration import Calibration, Procedure, load_calibration
from cellctl.calibration_runner import CalibrationRequest, calibrate_here
from cellctl.gun_programs import programs_of
from cellctl.studies.calibration import nees
from cellctl.twin import twin_of
from hal.clock import QuickenedLoop
from hal.config import CellConfig
from hal.fake.plant import Plant
from hal.fake.wire.stand import standing
from tests.calibrating.campaign import errors_of
from tests.calibrating.perturbed import overridden
from tests.journeys.twin_runs import RememberedJobs, small_recipe
from tests.journeys.wire_runs import CATCH_UP_S, wire_cell

BRISK = {"pdo_s": 1.0, "heartbeat_s": 1.0, "rate_hz": 100.0}
pytestmark = pytest.mark.nightly
MASSES_KG = (0.0, 80.0, 160.0)
OFF = {"force_gain": 1.1, "camera_rotor_shift_x_mm": 0.5, "camera_shaft_rotation_deg": 0.1}
OFF |= {"table_axis_shift_x_mm": 0.2, "jack_line_tilt_y_deg": 0.05}


def calibrated(config: CellConfig, procedures: tuple[Procedure, ...]) -> tuple[Calibration, Plant]:
    """Simulators and calibration in one process, on a quickened loop."""

    async def main() -> tuple[Calibration, Plant]:
        jobs, recipe = RememberedJobs(), small_recipe()
        twin = twin_of(recipe, config, jobs, seed=1)
        found = load_calibration(config.calibration_path)
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)):
            for procedure in procedures:
                asked = CalibrationRequest(procedure, config, found, recipe, 1, masses_kg=MASSES_KG)
                found = await calibrate_here(asked, jobs)
        return found, twin.plant

    with asyncio.Runner(loop_factory=partial(QuickenedLoop, 100.0, CATCH_UP_S)) as runner:
        return runner.run(main())


def test_weights_over_the_wire(tmp_path: Path) -> None:
    agree(*calibrated(overridden(wire_cell(tmp_path, **BRISK), OFF), ("force",)), ("force",))


def test_everything(tmp_path: Path) -> None:
    agree(*calibrated(overridden(wire_cell(tmp_path, **BRISK), OFF), ("camera", "axes", "force")))


def agree(found: Calibration, plant: Plant, procedures: tuple[Procedure, ...] = ("camera", "axes", "force")) -> None:
    """Every estimate within what it states of itself."""
    for name, one in errors_of(found, plant, procedures).items():
        assert nees(one.error[None], one.covariance[None])[0] < 5.0, (name, one.error, np.sqrt(np.diag(one.covariance)))
    assert not plant.damages
    assert all("serial" in line for made in found.made.values() for line in made.devices.values())
