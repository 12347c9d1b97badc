"""Face match and hole match on exact data: analytic cases, the sign convention, many seeds."""

import numpy as np
import pytest

from cellctl.vision.geometry import rotate
from cellctl.vision.match import match_faces, match_holes, pairings, polish

ANGLES = np.arange(36) * 10.0


def ring(radius: float = 120.0, angles_deg: np.ndarray = ANGLES) -> np.ndarray:
    angles = np.radians(angles_deg)
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def test_hole_match_recovers_an_exact_motion_whatever_its_size() -> None:
    generator = np.random.default_rng(1)
    for _ in range(300):
        theta = generator.uniform(-np.pi, np.pi)
        shift, pivot = generator.normal(0, 5, 2), generator.normal(0, 20, 2)
        holes = ring() + generator.normal(0, 5, 2)
        studs = pivot + rotate(holes - pivot, theta) + shift
        match = match_holes(holes, studs, generator.uniform(1e-6, 1e-4, 36), pivot, d0_mm=0.15)
        assert match.theta_rad == pytest.approx(theta, abs=1e-12)
        np.testing.assert_allclose(match.shift_mm, shift, atol=1e-10)
        assert match.eps_cyc == pytest.approx(0.0, abs=1e-9)


def test_theta_is_right_handed_about_the_outward_normal() -> None:
    holes = np.array([[100.0, 0.0], [0.0, 100.0], [-100.0, 0.0]])
    studs = np.array([[0.0, 100.0], [-100.0, 0.0], [0.0, -100.0]])
    assert np.degrees(match_holes(holes, studs, np.ones(3), np.zeros(2), d0_mm=1.0).theta_rad) == pytest.approx(90.0)


def test_hole_match_covariance_is_that_of_its_errors() -> None:
    generator = np.random.default_rng(2)
    sigma = generator.uniform(0.005, 0.02, 36)
    errors = []
    for _ in range(800):
        match = match_holes(
            ring() + generator.normal(0, sigma[:, None], (36, 2)), ring(), sigma**2, np.zeros(2), d0_mm=1
        )
        errors.append([*match.shift_mm, match.theta_rad])
    ratio = np.std(errors, axis=0) / np.sqrt(np.diag(match.covariance))
    assert np.all(np.abs(ratio - 1.0) < 0.1)


def test_index_of_the_paper_is_reported_with_its_definition() -> None:
    studs = ring()
    holes = studs.copy()
    holes[0] += [0.09, 0.0]
    match = match_holes(holes, studs, np.ones(36), np.zeros(2), d0_mm=0.15)
    distance = np.linalg.norm(match.residuals_mm, axis=1)
    assert match.eps_cyc == pytest.approx((distance.max() - distance.mean()) / 0.15)


def jacobian_of(points: np.ndarray) -> np.ndarray:
    jacobian = np.zeros((len(points), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -points[:, 1], points[:, 0]
    return jacobian


def test_polish_two_opposed_offsets_meet_in_the_middle() -> None:
    points = ring(100.0, np.array([0.0, 90.0, 180.0, 270.0]))
    offsets = np.array([[0.10, 0.0], [0.02, 0.0], [0.0, 0.0], [0.02, 0.0]])
    v = polish(offsets, jacobian_of(points), np.full(4, 0.15))
    left = np.linalg.norm(offsets + jacobian_of(points) @ v, axis=1)
    assert left.max() == pytest.approx(0.05, abs=2e-6)


def test_polish_is_optimal_and_never_worse_than_least_squares() -> None:
    generator = np.random.default_rng(3)
    points = ring()
    jacobian = jacobian_of(points)
    for _ in range(100):
        offsets = generator.normal(0, 0.02, (36, 2))
        room = generator.uniform(0.10, 0.15, 36)

        def worst(v: np.ndarray, offsets: np.ndarray = offsets, room: np.ndarray = room) -> float:
            return float(np.max(np.linalg.norm(offsets + jacobian @ v, axis=1) - room))

        v = polish(offsets, jacobian, room)
        best = worst(v)
        assert best <= worst(np.zeros(3))
        for step in generator.normal(0, 1, (60, 3)) * [1e-3, 1e-3, 1e-5]:
            assert worst(v + step) >= best - 2e-6


def test_faces_gap_and_tilt_are_exact() -> None:
    generator = np.random.default_rng(4)
    for _ in range(200):
        tilt, azimuth, gap = generator.uniform(0, 1.0), generator.uniform(0, 2 * np.pi), generator.uniform(1, 300)
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        normal = np.cos(np.radians(tilt)) * np.array([0, 0, 1.0]) + np.sin(np.radians(tilt)) * np.cross(
            axis, [0, 0, 1.0]
        )
        across = np.cross(normal, axis)
        plane = ring() @ np.stack([axis, across])
        rotor_points = np.column_stack([ring(), np.full(36, gap)])
        match = match_faces(
            (np.array([0, 0, gap]), np.array([0, 0, -1.0])),
            (np.zeros(3), normal),
            rotor_points,
            plane,
            np.array([0, 0, 1.0]),
            rim_radius_mm=140.0,
            h0_mm=3.0,
        )
        assert match.tilt_deg == pytest.approx(tilt, abs=1e-9)
        assert match.gap_mm == pytest.approx(gap, abs=1e-9)
        assert match.least_gap_mm == pytest.approx(gap - 140 * np.tan(np.radians(tilt)), abs=1e-9)
        np.testing.assert_allclose(match.h_i_mm, gap - plane[:, 2], atol=1e-9)
        assert match.h_j_mm.mean() == pytest.approx(gap * np.cos(np.radians(tilt)), abs=1e-9)


def test_a_uniform_gap_scores_nothing_in_the_paper_s_index() -> None:
    points = np.column_stack([ring(), np.zeros(36)])
    up = np.array([0, 0, 1.0])
    match = match_faces((5 * up, -up), (0 * up, up), points + 5 * up, points, up, rim_radius_mm=140.0, h0_mm=3.0)
    assert match.eps_pla == pytest.approx(0.0, abs=1e-12)
    assert match.gap_mm == pytest.approx(5.0)


def test_pairings_follow_the_pattern_s_own_symmetry() -> None:
    assert len(pairings(tuple(ANGLES), free=True)) == 36
    assert pairings(tuple(ANGLES), free=False) == (tuple(range(36)),)
    assert len(pairings((0.0, 45.0, 135.0, 225.0, 315.0), free=True)) == 1
    assert len(pairings((0.0, 90.0, 180.0, 270.0), free=True)) == 4
    assert pairings((0.0, 120.0, 240.0), free=True)[1] == (1, 2, 0)
