"""A twin made to the calibration's belief is where the calibration says, and a dry run on it is accepted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellctl.believed_twin import numbers_of
from cellctl.calibration import load_calibration
from cellctl.kinematics import AxesPosition, T_cell_table, rotation_about
from cellctl.workplace import run_on_twin
from hal.fake.frames import pose
from hal.fake.geometry import BenchGeometry
from hal.fake.levels import numbers
from hal.fake.parts import draw_cell
from hal.fake.stack import Motors
from hal.fake.stack import T_cell_table as true_table
from tests.calibrating.perturbed import believing
from tests.journeys.twin_runs import ROOT, small_recipe, twin_cell

FILE = load_calibration(ROOT / "deploy" / "calibration.fake.toml")


def odd_calibration():
    """Every part of the file off its nominal."""
    views = {}
    for view, turn in (("rotor", 0.1), ("shaft", -0.2)):
        off = pose(rotation_about(np.array([0.6, -0.64, 0.48]), np.radians(turn)), np.array([0.5, -0.3, 0.2]))
        rows = tuple(map(tuple, (off @ FILE.views[view].matrix).tolist()))
        views[view] = FILE.views[view].model_copy(update={"T_cell_scanner": rows})
    lean = np.array([3e-4, -5e-4, 1.0]) / np.linalg.norm([3e-4, -5e-4, 1.0])
    return FILE.model_copy(
        update={
            "views": views,
            "table_axis": FILE.table_axis.model_copy(
                update={"point_mm": (0.2, -0.1, 0.5), "direction": tuple(lean.tolist())}
            ),
            "jack_line": FILE.jack_line.model_copy(update={"direction": (1e-3, -4e-4, 1.0)}),
            "stage": FILE.stage.model_copy(update={"x_direction": (1.0, 1e-3, 0.0), "y_direction": (-2e-3, 1.0, 0.0)}),
            "jack_force": FILE.jack_force.model_copy(update={"gain": 0.9, "offset_n": 12.0}),
        }
    )


def test_the_truth_is_what_was_believed() -> None:
    belief = odd_calibration()
    cell = draw_cell(BenchGeometry(), numbers("ideal", numbers_of(belief)), 1)
    np.testing.assert_allclose(cell.T_cell_camera_rotor, belief.views["rotor"].matrix, atol=1e-9)
    np.testing.assert_allclose(cell.T_cell_camera_shaft, belief.views["shaft"].matrix, atol=1e-9)
    for place in ((0.0, 0.0, 0.0, 70.0), (5.0, -3.0, 0.0, -20.0), (1.0, 2.0, 390.0, 110.0)):
        believed = T_cell_table(belief, AxesPosition(*place))
        np.testing.assert_allclose(true_table(cell, Motors(*place), np.array(place[2]), 420.0), believed, atol=5e-4)
    assert cell.force_gain == pytest.approx(1.0 / 0.9)


def test_a_dry_run_goes_by_the_cells_own_calibration(tmp_path: Path) -> None:
    outcome = run_on_twin(small_recipe(), believing(twin_cell(), odd_calibration(), tmp_path), 3)
    assert outcome.verdict == "accepted", outcome.reasons
