"""Planes among clutter, and what the robust refit says about them."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import PlaneFrame
from cellctl.vision.part import FaceFit, Refused
from cellctl.vision.plane import Plane, find_planes, fit_face, refit
from tests.vision.fit.reference import Array, orientation

EYE = np.array([0.0, 0.0, 400.0])


def patch(rng: np.random.Generator, count: int, *, sigma: float = 0.03, height: float = 0.0) -> Array:
    return np.column_stack([rng.uniform(-120, 120, (count, 2)), height + rng.normal(0.0, sigma, count)])


def face_of(cloud: Array, start: Plane, eye: Array = EYE) -> FaceFit:
    """The face from points of it alone, about a plane, seen from `eye`."""
    toward = start.normal if start.residuals(eye) > 0.0 else -start.normal
    frame = PlaneFrame.on(start.distance_mm * start.normal, toward)
    return fit_face(Columns.of(cloud).into(frame), frame, start.sigma_mm)


def test_two_planes_come_largest_first_and_strays_are_no_third() -> None:
    rng = np.random.default_rng(1)
    cloud = np.vstack([patch(rng, 6000), patch(rng, 3000, height=-5.0), rng.uniform(-120, 120, (900, 3))])
    turn = orientation(rng)
    planes = tuple(find_planes(cloud @ turn.T, np.random.default_rng(0)))
    assert len(planes) == 2
    assert planes[0].points > planes[1].points
    assert abs(planes[0].normal @ turn[:, 2]) > 0.999999
    assert (
        abs(abs(planes[0].distance_mm - planes[1].distance_mm * np.sign(planes[0].normal @ planes[1].normal)) - 5.0)
        < 0.01
    )
    assert planes[0].sigma_mm == pytest.approx(0.03, rel=0.1)


def test_same_seed_same_planes() -> None:
    cloud = np.vstack([patch(np.random.default_rng(2), 4000), np.random.default_rng(3).uniform(-120, 120, (2000, 3))])
    first, second = (next(find_planes(cloud, np.random.default_rng(5))) for _ in range(2))
    assert np.array_equal(first.normal, second.normal) and first.distance_mm == second.distance_mm


@pytest.mark.parametrize("sigma", [0.005, 0.03, 0.09])
def test_normal_meets_the_bound(sigma: float) -> None:
    """Rms of the tilt over seeds within 1.5 of the white-noise bound, with 3 % outliers and the covariance honest."""
    tilts, heights, sigmas = [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        cloud = np.vstack([patch(rng, 4000, sigma=sigma), rng.uniform(-100, 100, (120, 3))])
        start = Plane(np.array([0.002, 0.001, 1.0]) / np.linalg.norm([0.002, 0.001, 1.0]), 0.05, 0.03, 4000)
        plane = refit(cloud, start, 0.15)
        face = face_of(cloud[np.abs(plane.residuals(cloud)) < 8 * plane.sigma_mm], plane)
        tilts.append(face.normal[:2])
        heights.append(face.point_mm @ face.normal)
        sigmas.append(np.sqrt(face.covariance[1, 1]))
    bound = sigma / np.sqrt(4000) / (120 / np.sqrt(3))
    assert np.sqrt(np.mean(np.square(tilts))) < 1.25 * bound
    assert np.sqrt(np.mean(np.square(heights))) < 1.4 * sigma / np.sqrt(4000)
    assert 0.8 * bound < np.mean(sigmas) < 1.4 * bound


def test_normal_points_to_the_eye_and_tilts_are_right_handed() -> None:
    rng = np.random.default_rng(9)
    cloud = patch(rng, 3000)
    for eye in (EYE, -EYE):
        face = face_of(cloud, refit(cloud, Plane(np.array([0.0, 0.0, 1.0]), 0.0, 0.03, 0), 0.15), eye)
        assert face.normal @ eye > 0
        assert np.allclose(np.cross(face.tilt_axes[0], face.tilt_axes[1]), face.normal)


def test_flatness_sees_a_bow_and_forgives_noise() -> None:
    rng = np.random.default_rng(10)
    cloud = patch(rng, 60_000)
    start = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 0.03, 0)
    assert face_of(cloud, start).flatness_mm < 0.02
    bowed = cloud.copy()
    bowed[:, 2] += 0.15 * (cloud[:, 0] / 120) ** 2
    assert face_of(bowed, start).flatness_mm == pytest.approx(0.15, abs=0.04)


def test_correlated_noise_widens_the_covariance() -> None:
    rng = np.random.default_rng(11)
    cells = rng.normal(0.0, 0.03, (200, 200))
    spread = np.kron(cells, np.ones((3, 3)))
    u, v = np.mgrid[0:600, 0:600] * 0.4
    start = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 0.03, 0)
    white = np.column_stack([u.ravel(), v.ravel(), rng.normal(0.0, 0.03, u.size)])
    shared = np.column_stack([u.ravel(), v.ravel(), spread.ravel()])
    ratio = face_of(shared, start).covariance[0, 0] / face_of(white, start).covariance[0, 0]
    assert 7.0 < ratio < 11.5  # nine pixels share one value


def test_too_little_of_a_face_is_refused() -> None:
    rng = np.random.default_rng(12)
    with pytest.raises(Refused, match="face_not_found"):
        face_of(patch(rng, 30), Plane(np.array([0.0, 0.0, 1.0]), 0.0, 0.03, 0))
