"""Ripple as a cause: its patterns have the covariance of random waves, and little of it moves a large pattern."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.docking.alignment import Station
from cellctl.docking.joint import joint_of, offsets_at, seat
from cellctl.docking.ripple import LONGEST_MM, SHORTEST_MM, correlation, rigid_motion, ripple_causes, slope_per_mm
from cellctl.kinematics import AxesPosition, T_cell_table

from .parts import HEIGHT, calibration, measurement, pose, recipe

ANGLES, MIRRORED = recipe().pattern.angles(), recipe().part("rotor").angles_deg
HOME = AxesPosition(0, 0, 0, 0)


def waves(places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(m, n) heights of m random waves of unit variance at places (n, 2)."""
    length = np.exp(rng.uniform(np.log(SHORTEST_MM), np.log(LONGEST_MM), (20_000, 1)))
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 20_000, 1))
    along = places[:, 0] * np.cos(angle) + places[:, 1] * np.sin(angle)
    return np.sqrt(2.0) * np.sin(2 * np.pi * along / length + phase)


def test_correlation_and_slope_are_those_of_random_waves() -> None:
    rng = np.random.default_rng(1)
    places = np.array([[0.0, 0.0], [0.01, 0.0], [15.0, 0.0], [40.0, 0.0], [120.0, 0.0], [240.0, 0.0]])
    height = waves(places, rng)
    assert np.mean(height[:, :1] * height, axis=0) == pytest.approx(correlation(places[:, 0]), abs=0.04)
    slope = np.sqrt(np.mean(((height[:, 1] - height[:, 0]) / 0.01) ** 2))
    assert slope_per_mm() == pytest.approx(slope, rel=0.1)


def _causes(share: float) -> tuple[np.ndarray, np.ndarray]:
    cal = calibration()
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    joint = joint_of(rotor, measurement("hole", pose(), ANGLES), tuple(range(36)), cal, HOME)
    target = seat(joint, cal, HOME, 0.0)
    kept = np.full(36, share)
    return (
        ripple_causes(
            joint, cal, T_cell_table(cal, HOME), (kept, kept), lambda seen: offsets_at(seen, cal, target, Station(0.0))
        ),
        offsets_at(joint, cal, target, Station(0.0))[1],
    )


def test_a_bolt_moves_by_the_slant_of_its_ray_and_the_pattern_by_much_less() -> None:
    effects, jacobian = _causes(1.0)
    slant = 120.0 / np.hypot(120.0, 350.0)
    each = np.sqrt(np.mean(np.sum(effects**2, axis=(1, 2))))
    assert each == pytest.approx(np.sqrt(2.0) * 0.01 * slant, rel=0.02)  # radial, both views
    whole = np.sqrt(np.sum(rigid_motion(effects, jacobian)[:2] ** 2, axis=1))
    assert 0.02 * each < whole.max() < 0.4 * each


def test_what_is_drawn_to_the_pattern_follows_ripple_as_a_whole_only() -> None:
    effects, jacobian = _causes(0.0)
    whole = np.einsum("iak,kc->iac", jacobian, rigid_motion(effects, jacobian))
    np.testing.assert_allclose(effects, whole, atol=1e-12)
    np.testing.assert_allclose(rigid_motion(_causes(1.0)[0], jacobian), rigid_motion(effects, jacobian), atol=1e-12)
