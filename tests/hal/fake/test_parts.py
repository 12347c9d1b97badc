"""Drawing the truth: repeatable, quantity by quantity, with the scatter that the table says."""

from __future__ import annotations

import numpy as np
import pytest

from hal.fake.frames import child_rng, small_pose
from hal.fake.geometry import BenchGeometry
from hal.fake.levels import TwinNumbers, numbers
from hal.fake.parts import draw_cell, draw_rotor, draw_shaft
from tests.hal.fake.bench_plant import equal_joint

JOINT, BENCH = equal_joint(), BenchGeometry()
NOMINAL = numbers("nominal")


def test_the_same_serial_number_is_the_same_part() -> None:
    first, again = draw_shaft(JOINT, NOMINAL, 7, "S-1"), draw_shaft(JOINT, NOMINAL, 7, "S-1")
    other, elsewhere = draw_shaft(JOINT, NOMINAL, 7, "S-2"), draw_shaft(JOINT, NOMINAL, 8, "S-1")
    assert (first.hole_mm == again.hole_mm).all()
    assert (first.T_chuck_shaft == again.T_chuck_shaft).all()
    assert (first.hole_mm != other.hole_mm).all()
    assert (first.hole_mm != elsewhere.hole_mm).all()


def test_random_children_do_not_depend_on_the_hash_seed() -> None:
    assert child_rng(1, "shaft", "S-1").integers(2**32) == 481801695


def test_changing_one_number_leaves_the_other_quantities_as_they_were() -> None:
    base = draw_shaft(JOINT, NOMINAL, 7, "S-1")
    tilted = draw_shaft(JOINT, numbers("nominal", {"feature_tilt_deg": 0.2}), 7, "S-1")
    assert (tilted.hole_mm == base.hole_mm).all()
    assert tilted.mass_kg == base.mass_kg
    assert tilted.slope == pytest.approx(10.0 * base.slope)


def test_scatter_is_that_of_the_table() -> None:
    shafts = [draw_shaft(JOINT, NOMINAL, seed, "S") for seed in range(200)]
    nominal = JOINT.pattern_mm("shaft")
    assert np.std([s.hole_mm - nominal for s in shafts]) == pytest.approx(0.010, rel=0.03)
    assert np.degrees(np.std([s.slope for s in shafts])) == pytest.approx(0.02, rel=0.03)
    assert np.std([s.T_chuck_shaft[:2, 3] for s in shafts]) == pytest.approx(2.0, rel=0.15)
    assert np.degrees(np.std([s.T_chuck_shaft[:2, 2] for s in shafts])) == pytest.approx(0.015, rel=0.15)
    assert np.std([s.interference_mm for s in shafts]) == pytest.approx(0.005, rel=0.15)
    assert np.mean([s.interference_mm for s in shafts]) == pytest.approx(0.060, abs=0.002)
    clocking = [np.degrees(np.arctan2(s.T_chuck_shaft[1, 0], s.T_chuck_shaft[0, 0])) for s in shafts]
    assert np.std(clocking) == pytest.approx(360.0 / np.sqrt(12.0), rel=0.15)


def test_view_to_view_scatter_is_that_of_the_table() -> None:
    cells = [draw_cell(BENCH, NOMINAL, seed) for seed in range(400)]
    errors = [
        np.linalg.inv(BENCH.T_cell_camera_rotor)
        @ c.T_cell_camera_rotor
        @ np.linalg.inv(np.linalg.inv(BENCH.T_cell_camera_shaft) @ c.T_cell_camera_shaft)
        for c in cells
    ]
    assert np.degrees(np.std([e[0, 1] for e in errors])) == pytest.approx(0.002, rel=0.1)
    assert np.std([e[:3, 3] for e in errors]) == pytest.approx(0.005, rel=0.1)


def test_ideal_parts_are_the_drawing() -> None:
    ideal = numbers("ideal")
    rotor, shaft = draw_rotor(JOINT, BENCH, ideal, 1, "R"), draw_shaft(JOINT, ideal, 1, "S")
    cell = draw_cell(BENCH, ideal, 1)
    assert (shaft.T_chuck_shaft == np.eye(4)).all()
    assert (shaft.hole_mm == JOINT.pattern_mm("shaft")).all()
    studs = np.column_stack([rotor.stud_mm, np.zeros(36), np.ones(36)]) @ rotor.T_cell_rotor.T
    assert studs[:, :2] == pytest.approx(shaft.hole_mm)
    assert studs[:, 2] == pytest.approx(np.full(36, 400.0))
    assert (cell.T_cell_camera_rotor == BENCH.T_cell_camera_rotor).all()
    assert not cell.scale.any()


def perturbed(**overrides: float) -> TwinNumbers:
    return numbers("ideal", overrides)


def test_perturbations_move_the_truth() -> None:
    cell = draw_cell(BENCH, perturbed(camera_rotor_shift_x_mm=0.5, camera_shaft_rotation_deg=0.1), 1)
    assert cell.T_cell_camera_rotor[:3, 3] == pytest.approx([0.5, 0.0, 50.0])
    expected = BENCH.T_cell_camera_shaft @ small_pose(np.zeros(3), np.array([0.0, 0.0, 0.1]))
    assert cell.T_cell_camera_shaft == pytest.approx(expected)
    assert draw_cell(BENCH, perturbed(table_axis_shift_x_mm=0.2), 1).table_point_mm[0] == 0.2
    assert draw_cell(BENCH, perturbed(force_gain=1.1), 1).force_gain == 1.1
    shaft = draw_shaft(JOINT, perturbed(shaft_mass_kg=120.0, fit_interference_mm=0.09, hole_diameter_mm=8.1), 1, "S")
    assert (shaft.mass_kg, shaft.interference_mm) == (120.0, 0.09)
    assert (shaft.diameter_mm == 8.1).all()
    moved = draw_shaft(JOINT, perturbed(hole_0_shift_x_mm=0.3, circle_diameter_shift_mm=0.2), 1, "S")
    assert moved.hole_mm[0] == pytest.approx([120.4, 0.0])
    assert moved.hole_mm[18] == pytest.approx([-120.1, 0.0])
