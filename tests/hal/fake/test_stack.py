"""The true kinematic chain against the controller's own and against its table of errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellctl.calibration import load_calibration
from cellctl.kinematics import AxesPosition
from cellctl.kinematics import T_cell_table as believed_table
from hal.fake.geometry import BenchGeometry
from hal.fake.levels import numbers
from hal.fake.parts import draw_cell
from hal.fake.stack import Motors, T_cell_table, jack_errors, true_linear_mm, true_theta_rad

STROKE = 420.0
CALIBRATION = load_calibration(Path("deploy/calibration.fake.toml"))


def test_an_ideal_cell_is_what_the_controller_believes() -> None:
    cell = draw_cell(BenchGeometry(), numbers("ideal"), 1)
    for x, y, z, theta in np.random.default_rng(0).uniform(-10.0, 10.0, (20, 4)):
        true = T_cell_table(cell, Motors(x, y, z, theta), np.array(z), STROKE)
        assert true == pytest.approx(believed_table(CALIBRATION, AxesPosition(x, y, z, theta)), abs=1e-12)


def test_nominal_is_off_by_micrometres_and_hostile_by_more() -> None:
    def miss_mm(level: str) -> float:
        misses = []
        for seed in range(60):
            cell = draw_cell(BenchGeometry(), numbers(level), seed)  # type: ignore[arg-type]
            true = T_cell_table(cell, Motors(3.0, -2.0, 390.0, 4.0), np.array(390.0), STROKE)
            misses.append(true[:2, 3] - believed_table(CALIBRATION, AxesPosition(3.0, -2.0, 390.0, 4.0))[:2, 3])
        return float(np.std(misses))

    # 0.002 deg over 390 mm is 13.6 um, straightness 5 um, backlash and runout 3 um.
    assert 0.010 < miss_mm("nominal") < 0.022
    assert miss_mm("hostile") > 2.0 * miss_mm("nominal")


def test_the_jack_drifts_smoothly_from_the_height_at_which_the_shaft_was_scanned() -> None:
    cell = draw_cell(BenchGeometry(), numbers("nominal"), 3)
    heights = np.linspace(0.0, STROKE, 421)
    drift, roll = jack_errors(cell, heights, STROKE)
    assert (drift[0] == 0.0).all()
    assert roll[0] == 0.0
    assert np.abs(np.diff(drift, axis=0)).max() < 5e-4
    assert np.abs(np.diff(drift, n=2, axis=0)).max() < 1e-5
    ends = [
        jack_errors(draw_cell(BenchGeometry(), numbers("nominal"), s), np.array([STROKE]), STROKE) for s in range(300)
    ]
    straight = [
        e[0][0] - STROKE * draw_cell(BenchGeometry(), numbers("nominal"), s).jack_slope for s, e in enumerate(ends)
    ]
    assert np.std(straight) == pytest.approx(0.005, rel=0.1)
    assert np.degrees(np.std([e[1] for e in ends])) == pytest.approx(0.001, rel=0.15)


def test_backlash_is_lost_when_the_direction_turns() -> None:
    cell = draw_cell(BenchGeometry(), numbers("nominal"), 2)
    up, down = (float(true_linear_mm(cell, 0, np.array(5.0), way)) for way in (1.0, -1.0))
    assert down - up == pytest.approx(cell.backlash_mm[0])


def test_the_tables_encoder_is_eccentric() -> None:
    errors = []
    for seed in range(200):
        cell = draw_cell(BenchGeometry(), numbers("nominal"), seed)
        errors += [np.degrees(true_theta_rad(cell, theta)) - theta for theta in (-90.0, 0.0, 35.0, 170.0)]
    assert np.std(errors) == pytest.approx(0.003, rel=0.15)


def test_a_shifted_table_axis_swings_the_shaft() -> None:
    cell = draw_cell(BenchGeometry(), numbers("ideal", {"table_axis_shift_x_mm": 0.2}), 1)
    half = T_cell_table(cell, Motors(0.0, 0.0, 0.0, 180.0), np.array(0.0), STROKE)
    assert half[:3, 3] == pytest.approx([0.4, 0.0, 0.0], abs=1e-12)


def test_a_stage_out_of_square_goes_where_its_axes_point() -> None:
    askew = draw_cell(BenchGeometry(), numbers("ideal", {"stage_x_turn_deg": 1.0, "stage_y_turn_deg": -2.0}), 1)
    moved = T_cell_table(askew, Motors(5.0, 3.0, 0.0, 0.0), np.array(0.0), STROKE)[:2, 3]
    x, y = np.radians([1.0, -2.0])
    assert moved == pytest.approx([5.0 * np.cos(x) - 3.0 * np.sin(y), 5.0 * np.sin(x) + 3.0 * np.cos(y)])
