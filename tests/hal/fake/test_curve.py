"""The force over the height: energy, jams, press fit, faces, withdrawal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hal.fake.contact.curve import ForceCurve, force_curve, gap_grid
from hal.fake.contact.docking import at_best_pose, moved
from hal.fake.contact.insertion import Dock, bending_n_per_mm, meeting
from tests.hal.fake.bench_plant import equal_joint, plant_of


def best(level: str = "nominal", seed: int = 1, **properties: float) -> Dock:
    """A dock at its best pose, with the fit wide open."""
    dock = plant_of(level, seed=seed, overrides=properties).dock()  # type: ignore[arg-type]
    return replace(at_best_pose(dock), interference_mm=-1.0)


def strain_n_mm(dock: Dock, curve: ForceCurve) -> np.ndarray:
    """Energy stored in chuck and studs at each height, from the float and the studs' lateral forces."""
    chuck = 0.5 * (curve.float_mm**2) @ dock.stiffness_n_per_mm()
    met = meeting(dock, dock.heights_mm(curve.gap_mm))
    bend = bending_n_per_mm(dock.geometry, dock.properties, met.gap_mm + np.minimum(32.0 - met.gap_mm, 0.8))
    return np.asarray(chuck + (0.5 * curve.stud_lateral_n**2 / bend).sum(axis=1))


@pytest.mark.parametrize(("x_mm", "theta_deg"), [(0.4, 0.0), (0.0, 0.2), (0.3, -0.15), (0.6, 0.3)])
def test_without_friction_the_axial_work_is_the_energy_stored(x_mm: float, theta_deg: float) -> None:
    # Studs of one stiffness: a stiffness that changes with the height would do work of its own.
    dock = moved(best(friction_coefficient=0.0, stud_fixity=1e4), x_mm, 0.0, theta_deg)
    cones_end = 32.0 - dock.geometry.lead_in_mm - dock.geometry.chamfer_depth_mm
    curve = force_curve(dock, np.arange(32.2, cones_end + 0.06, -0.0025))
    work = np.concatenate([[0.0], np.cumsum(0.5 * (curve.in_n[1:] + curve.in_n[:-1]) * -np.diff(curve.gap_mm))])
    stored = strain_n_mm(dock, curve)
    assert stored[-1] > 5.0
    for share in (0.1, 0.5, 0.9):
        at = int(np.argmax(stored >= share * stored[-1]))
        assert work[at] == pytest.approx(stored[at], rel=0.002)


def test_friction_costs_work_on_the_way_in_and_takes_it_on_the_way_out() -> None:
    dock = moved(best(), 0.25, 0.0, 0.0)
    curve = force_curve(dock)
    assert (curve.in_n >= curve.out_n - 1e-9).all()
    deep = np.argmin(np.abs(curve.gap_mm - 15.0))
    lateral = curve.stud_lateral_n[deep].sum()
    assert lateral > 10.0
    assert curve.in_n[deep] == pytest.approx(0.15 * lateral)
    assert curve.out_n[deep] == pytest.approx(-0.15 * lateral)


def test_at_the_best_pose_a_nominal_joint_is_free_of_contact() -> None:
    for seed in range(10):
        curve = force_curve(best(seed=seed), np.arange(32.5, 3.0, -0.5))
        assert curve.in_n.max() == 0.0


def test_totals_are_the_sum_of_the_studs_until_the_spigot_engages() -> None:
    dock = moved(best(), 0.2, 0.1, 0.05)
    gaps = gap_grid(dock)
    curve = force_curve(dock, gaps[gaps > 3.0])
    assert curve.in_n.max() > 10.0
    assert curve.in_n == pytest.approx(curve.stud_in_n.sum(axis=1))


def test_beyond_the_chamfer_the_studs_jam_and_the_column_yields() -> None:
    reach_mm = 4.95 - 0.5 * (8.0 - 1.22687)
    free = force_curve(moved(best("ideal"), reach_mm - 0.02, 0.0, 0.0))
    assert not free.jammed.any()
    dock = moved(best("ideal"), reach_mm + 0.02, 0.0, 0.0)
    curve = force_curve(dock)
    assert curve.jammed.all()
    assert curve.gap_mm[-1] == pytest.approx(32.0, abs=1e-6)
    further = curve.z_mm[-1] + np.array([0.1, 1.0])
    assert curve.force_n(further, inwards=True) == pytest.approx([135.0, 1350.0], rel=1e-6)
    assert curve.gap_at(float(further[1])) == pytest.approx(32.0, abs=1e-6)
    axial, _ = curve.stud_peaks_n(0.0, float(further[1]))
    assert axial == pytest.approx(np.full(36, 1350.0 / 36))


@pytest.mark.parametrize("shift_mm", [0.5, -0.5])
def test_studs_that_wedge_against_each_other_are_met_through_the_column(shift_mm: float) -> None:
    curve = force_curve(best("ideal", circle_diameter_shift_mm=shift_mm), np.arange(32.2, 29.0, -0.01))
    assert not curve.jammed.any()
    assert (np.diff(curve.z_mm) > 0.0).all()
    rise = np.diff(curve.in_n) / -np.diff(curve.gap_mm)
    assert rise.max() > 50_000.0, "each bends its stud, and the chuck cannot give way to all of them"
    felt = [curve.stiffness_n_per_mm(float(z)) for z in curve.z_mm]
    assert 1200.0 < max(felt) <= 1350.0 + 1e-6


def test_a_cone_beyond_the_wedging_limit_jams() -> None:
    assert force_curve(moved(best("ideal", friction_coefficient=1.0), 0.2, 0.0, 0.0)).jammed.all()
    assert not force_curve(moved(best("ideal", friction_coefficient=0.9), 0.2, 0.0, 0.0)).jammed.any()


def test_a_cold_fit_is_pressed_with_the_column_in_series() -> None:
    dock = replace(best("ideal"), interference_mm=0.06)
    curve = force_curve(dock)
    assert curve.gap_at(float(curve.z_mm[-1])) == 0.0
    assert (np.diff(curve.z_mm) > 0.0).all()
    # mu p pi D over 2.5 mm, p = delta E / (D (c_o + c_i)) with c = 2.4087 and 4.0625
    pressure = 0.06 * 206_000.0 / (180.0 * (2.40870 + 4.0625))
    assert curve.in_n[-1] == pytest.approx(0.15 * pressure * np.pi * 180.0 * 2.5, rel=1e-3)
    assert curve.in_n[-1] > 2000.0
    assert curve.z_mm[-1] == pytest.approx(400.0 + curve.in_n[-1] / 1350.0, abs=1e-3)


def test_an_open_fit_seats_without_force() -> None:
    curve = force_curve(best("ideal"))
    assert curve.in_n.max() == 0.0
    assert curve.force_n(curve.z_mm[-1:] + 0.2, inwards=True) == pytest.approx([270.0])


def test_tilted_faces_align_under_force() -> None:
    tilt_deg = 0.03
    curve = force_curve(best("ideal", shaft_tilt_x_deg=tilt_deg))
    flatten_n = 3.0e7 / 140.0**2 * 140.0 * np.radians(tilt_deg)
    assert curve.in_n[-1] == pytest.approx(flatten_n, rel=1e-3)
    assert curve.gap_at(float(curve.z_mm[-1])) == 0.0


def test_nuts_pull_the_joint_closed_against_the_fit() -> None:
    cold = replace(best("ideal"), interference_mm=0.06)
    z_mm = 398.0
    assert force_curve(cold).gap_at(z_mm) > 1.5
    assert force_curve(replace(cold, clamp_force_n=50_000.0)).gap_at(z_mm) == 0.0


def test_hot_holes_grow_against_the_studs() -> None:
    grown = replace(best(), circle_growth=80.0 * 12.5e-6)
    assert force_curve(best(), np.array([5.0])).in_n[0] == 0.0
    curve = force_curve(grown, np.array([5.0]))
    assert curve.stud_lateral_n.max() > 1.0
    assert curve.float_mm[0] == pytest.approx([0.0, 0.0, 0.0], abs=0.05)


def test_a_softer_open_chuck_gives_way() -> None:
    dock = moved(best(), 0.3, 0.0, 0.0)
    held = force_curve(dock).stud_lateral_n.max()
    assert force_curve(replace(dock, clamped=False)).stud_lateral_n.max() < 0.3 * held


def test_studs_bend_as_beams_within_the_range_of_the_design_book() -> None:
    stiffness = bending_n_per_mm(equal_joint(), best().properties, np.array([33.0, 24.0, 0.0]))
    assert 8_000.0 < stiffness[0] < stiffness[1] < 23_000.0
    assert stiffness[2] == 100_000.0
