"""Forecast, contact and temperature window against analytic cases."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from cellctl.vision.contact import ContactModel, lateral_forces
from cellctl.vision.uncertainty import (
    Belief,
    clearance,
    forecast,
    radial_sigma,
    temperature_window,
)

MODEL = ContactModel()


def belief(count: int = 36, *, scatter: float = 0.0, rigid=(0.0, 0.0, 0.0), room: float = 0.15, growth: float = 0.0):
    angles = np.arange(count) * 2 * np.pi / count
    points = 120.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    jacobian = np.zeros((count, 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -points[:, 1], points[:, 0]
    return Belief(
        offsets_mm=np.zeros((1, count, 2)),
        entering=np.ones(1, dtype=bool),
        lag_mm=np.zeros(count),
        growth_mm_per_k=growth * points,
        jacobian=jacobian,
        shared_mm=(jacobian @ np.diag(rigid))[None],
        own_mm=np.full((1, count, 1), scatter),
        clearance_mm=np.full(count, room),
    )


def test_probability_of_independent_bolts_is_the_product_of_rayleigh_terms() -> None:
    for sigma in (0.03, 0.045, 0.06):
        expected = (1 - np.exp(-(0.15**2) / (2 * sigma**2))) ** 36
        found = forecast(belief(scatter=sigma), MODEL, np.random.default_rng(8), samples=20000)
        assert found.p_free == pytest.approx(expected, abs=5 * found.sigma_p + 1e-3)


def test_probability_of_a_common_shift_is_one_rayleigh_term() -> None:
    found = forecast(belief(rigid=(0.1, 0.1, 0.0)), MODEL, np.random.default_rng(9), samples=20000)
    assert found.p_free == pytest.approx(1 - np.exp(-(0.15**2) / (2 * 0.1**2)), abs=5 * found.sigma_p)


def test_one_cause_moves_all_stations_by_the_same_draw() -> None:
    seated = belief(rigid=(0.05, 0.05, 0.0))
    way_in = replace(
        seated,
        offsets_mm=np.repeat(seated.offsets_mm, 2, axis=0),
        entering=np.array([True, False]),
        shared_mm=np.concatenate([2.0 * seated.shared_mm, seated.shared_mm]),
        own_mm=np.repeat(seated.own_mm, 2, axis=0),
    )
    found = forecast(way_in, MODEL, np.random.default_rng(9), samples=20000)
    # whoever passes where the cause acts twice as much passes where it acts once
    assert found.p_free == pytest.approx(1 - np.exp(-(0.15**2) / (2 * 0.1**2)), abs=5 * found.sigma_p)
    assert way_in.seated().shared_mm == pytest.approx(seated.shared_mm)


def test_probability_of_a_turn_is_a_normal_integral() -> None:
    sigma = np.radians(0.05)
    found = forecast(belief(rigid=(0.0, 0.0, sigma)), MODEL, np.random.default_rng(10), samples=20000)
    assert found.p_free == pytest.approx(1 - 2 * norm.sf(0.15 / 120 / sigma), abs=5 * found.sigma_p)


def test_growth_takes_the_clearance_away() -> None:
    hot = belief(scatter=0.005, growth=12.5e-6)
    assert forecast(hot, MODEL, np.random.default_rng(11), difference_k=40).p_free > 0.999
    assert forecast(hot, MODEL, np.random.default_rng(11), difference_k=105).p_free < 0.1


def test_one_stud_alone_pushes_the_shaft_aside() -> None:
    """Spring against spring: overlap 20 um shared between the shaft (also turning) and the stud's bending."""
    one = belief(1)
    offsets = np.array([[[0.17, 0.0]]])  # radial: the shaft floats in x only
    force = lateral_forces(offsets, one.jacobian, one.clearance_mm, MODEL)
    lateral = 0.02 / (1 / 1000.0 + 1 / 15000.0)
    assert force[0, 0] == pytest.approx(lateral, rel=1e-6)
    across = lateral_forces(np.array([[[0.0, 0.17]]]), one.jacobian, one.clearance_mm, MODEL)
    lateral = 0.02 / (2 / 1000.0 + 1 / 15000.0)  # y and turn give way in series
    assert across[0, 0] == pytest.approx(lateral, rel=2e-3)


def test_a_shift_that_the_shaft_can_float_away_costs_its_spring_only() -> None:
    all_of_them = belief(36)
    offsets = np.tile([[0.16, 0.0]], (1, 36, 1))
    force = lateral_forces(offsets, all_of_them.jacobian, all_of_them.clearance_mm, MODEL)
    assert force.sum() == pytest.approx(0.01 * 1000.0, rel=0.01)


def test_no_overlap_no_force() -> None:
    free = belief(36)
    assert lateral_forces(np.zeros((3, 36, 2)), free.jacobian, free.clearance_mm, MODEL).max() == 0.0


FIT = {
    "interference_mm": 0.06,
    "tolerance_mm": 0.005,
    "open_by_mm": 0.02,
    "expansion_per_k": 12.5e-6,
    "spigot_diameter_mm": 180.0,
}


def test_window_is_two_sided_and_exact_for_a_perfect_pattern() -> None:
    hot = belief(scatter=0.004, growth=12.5e-6)
    window = temperature_window(
        hot,
        interference_mm=0.06,
        tolerance_mm=0.005,
        open_by_mm=0.02,
        expansion_per_k=12.5e-6,
        spigot_diameter_mm=180.0,
    )
    assert window.low_k == pytest.approx(0.085 / (12.5e-6 * 180))
    assert window.high_k == pytest.approx((0.15 - 0.012) / (12.5e-6 * 120))
    assert window.exists


def test_window_without_room_is_empty_and_says_which_bolt() -> None:
    tight = belief(scatter=0.02, room=0.10, growth=12.5e-6)
    window = temperature_window(
        tight,
        interference_mm=0.06,
        tolerance_mm=0.005,
        open_by_mm=0.02,
        expansion_per_k=12.5e-6,
        spigot_diameter_mm=180.0,
    )
    assert not window.exists
    assert "bolt" in window.reason


def test_clearance_is_the_least_over_the_way_in() -> None:
    offsets = np.array([[[0.03, 0.04]], [[0.0, 0.1]]])
    assert clearance(offsets, np.array([0.15])) == pytest.approx([0.05])


def test_radial_sigma_joins_rigid_and_scatter() -> None:
    sigma = radial_sigma(belief(scatter=0.03, rigid=(0.04, 0.04, 0.0)))
    assert sigma == pytest.approx(np.full((1, 36), 0.05))
