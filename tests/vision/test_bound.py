"""The bound calculator against an oracle that knows every label and fits the true surfaces by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from cellctl.vision.part import Part
from tests.vision.bound import Inside, bound, information, insides
from tests.vision.synthetic import View, pose_above

SEEDS = 300
PART = Part("hole", 120.0, (0.0, 90.0, 200.0), diameter_mm=(9.0,) * 3, chamfer_diameter_mm=11.0, depth_mm=12.0,
            chamfer_angle_deg=45.0, face_inner_diameter_mm=80.0, face_outer_diameter_mm=150.0)  # fmt: skip
VIEW = View(PART, pose_above(330.0, (0.01, -0.006), 0.2), pixels=220, field_mm=170.0, lost=0.0)


def misses(x: np.ndarray, hole: Inside, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted orthogonal distances of noisy points (m, 3) to cone and wall of parameters centre, chamfer, wall."""
    rho = np.hypot(points[:, 0] - x[0], points[:, 1] - x[1])
    angle = np.arctan(hole.slope)
    cone = (rho - x[2]) * np.cos(angle) - points[:, 2] * np.sin(angle)
    return np.asarray(np.where(hole.cone, cone, rho - x[3]) * weights)


def test_oracle_reaches_the_bound() -> None:
    rng = np.random.default_rng(11)
    sigma = 0.03
    for hole in insides(VIEW):
        covariance = np.linalg.inv(information(hole, sigma, 1e-9))[:4, :4]
        start = np.array([0.0, 0.0, hole.mouth_mm, hole.wall_mm])
        step, one = 1e-4, np.ones(len(hole.points))  # noise across the surface, by moving every point along its ray
        ahead, behind = (misses(start, hole, hole.points + way * hole.rays, one) for way in (step, -step))
        across = (ahead - behind) / (2.0 * step)
        weights = 1.0 / (sigma * np.abs(across))
        errors = []
        for _ in range(SEEDS // 3):
            noisy = hole.points + rng.normal(0.0, sigma, (len(hole.points), 1)) * hole.rays
            errors.append(least_squares(misses, start, args=(hole, noisy, weights)).x - start)
        ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.diag(covariance))
        # rms of 100 draws: one sigma is 7 %
        assert np.abs(ratio - 1.0).max() < 0.25, ratio
        assert abs(float(np.mean(ratio)) - 1.0) < 0.12


def test_bound_goes_with_the_root_of_the_points() -> None:
    few, many = (bound(View(PART, VIEW.T_scanner_part, pixels=n, field_mm=170.0, lost=0.0)) for n in (330, 990))
    for name, within in (("normal_deg", 0.02), ("offset_mm", 0.02), ("centre_mm", 0.4), ("clocking_deg", 0.4)):
        # a hole's bound hangs on the few rays that graze its wall
        assert getattr(few, name) / getattr(many, name) == pytest.approx(3.0, rel=within)
