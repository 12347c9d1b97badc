"""The drawing's positions as a prior, against conditioning of joint normal numbers done in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellctl.docking.prior import believed
from cellctl.docking.ripple import RippleNoise
from cellctl.vision.part import FeatureFit, PartMeasurement, pivot

from .parts import measurement, pose, recipe

ANGLES = recipe().pattern.angles()
NOISE_MM, LEAN_RAD, PIVOT_MM, PLACE_MM = 0.012, 4e-4, 22.0, 0.010
QUIET = RippleNoise(np.zeros(36), np.zeros(36))


def seen(errors: np.ndarray, noise_mm: float = NOISE_MM) -> PartMeasurement:
    part = measurement("hole", pose(), ANGLES, errors=errors, sigma_mm=noise_mm)
    lean = float(np.degrees(LEAN_RAD))
    features = tuple(replace(feature, axis_sigma_deg=lean, pivot_mm=PIVOT_MM) for feature in part.features)
    return replace(part, features=features)


def joint_normal() -> tuple[np.ndarray, np.ndarray]:
    """Covariance (2, 2) of centre and slope errors of one feature, and that of the true place."""
    together = -PIVOT_MM * LEAN_RAD**2
    return np.array([[NOISE_MM**2, together], [together, LEAN_RAD**2]]), np.diag([PLACE_MM**2, 0.0])


def test_centre_and_lean_are_those_of_the_joint_normal_law() -> None:
    rng = np.random.default_rng(1)
    errors = rng.normal(0, 0.011, (36, 2))
    before = seen(errors)
    after, share = believed(before, ANGLES, PLACE_MM, QUIET)
    noise, place = joint_normal()
    # gain of (centre, slope) errors given what the centre shows: it shows their sum with the true place
    gain = noise[:, 0] / (noise[0, 0] + place[0, 0])
    for old, new in zip(before.features, after.features, strict=True):
        miss = old.center_mm - _place(old, before)
        assert new.center_mm - old.center_mm == pytest.approx(-gain[0] * miss, abs=1e-9)
        assert new.axis[:2] == pytest.approx(-gain[1] * miss[:2], abs=1e-9)
        left = noise - np.outer(noise[:, 0], noise[:, 0]) / (noise[0, 0] + place[0, 0])
        assert new.covariance_mm2[0, 0] == pytest.approx(left[0, 0], rel=1e-6)
        assert np.radians(new.axis_sigma_deg) ** 2 == pytest.approx(left[1, 1], rel=1e-6)
        assert -new.pivot_mm * left[1, 1] == pytest.approx(left[0, 1], rel=1e-6)
    assert share == pytest.approx(np.full(36, 1.0 - gain[0]))


def _place(feature: FeatureFit, part: PartMeasurement) -> np.ndarray:
    angle = np.radians(ANGLES[feature.index])
    return part.T_frame_part[:3, 3] + 0.5 * part.circle_diameter_mm * np.array([np.cos(angle), np.sin(angle), 0.0])


def test_what_is_believed_is_as_far_from_the_truth_as_it_says() -> None:
    rng = np.random.default_rng(2)
    ripple = RippleNoise(np.full(36, 0.003**2), np.full(36, 0.006**2))
    squares, stated = [], []
    for _ in range(40):
        true = rng.normal(0, PLACE_MM, (36, 2))
        waves = rng.normal(0, 0.006, (36, 2))
        noisy = true + waves + rng.normal(0, np.hypot(NOISE_MM, 0.003), (36, 2))
        after, share = believed(seen(noisy), ANGLES, PLACE_MM, ripple)
        nominal = np.array([_place(feature, after)[:2] for feature in after.features])
        miss = np.array([feature.center_mm[:2] for feature in after.features]) - nominal - true - share[:, None] * waves
        squares.append(np.mean(miss**2))
        stated.append(np.mean([feature.covariance_mm2[0, 0] for feature in after.features]))
    assert np.mean(squares) == pytest.approx(np.mean(stated), rel=0.1)


def test_a_part_out_of_tolerance_is_believed_to_be_so_and_ripple_is_not_taken_for_one() -> None:
    rng = np.random.default_rng(3)
    wide = rng.normal(0, 0.05, (36, 2))
    _, share = believed(seen(wide), ANGLES, PLACE_MM, QUIET)
    assert share.min() > 0.9
    _, share = believed(seen(wide), ANGLES, PLACE_MM, RippleNoise(np.zeros(36), np.full(36, 0.05**2)))
    assert share.max() < 0.25


def test_pivot_of_a_covariance() -> None:
    place, lean = 0.004**2, 3e-4**2
    lever = np.kron(np.array([[1.0, -17.0], [0.0, 1.0]]), np.eye(2))  # a place 17 mm up and slopes, carried to the face
    assert pivot(lever @ np.diag([place, place, lean, lean]) @ lever.T) == pytest.approx(17.0)
    assert pivot(np.zeros((4, 4))) == 0.0
