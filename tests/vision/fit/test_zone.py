"""Minimum zones against constructions whose zone is known, and against brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellctl.vision import fit
from tests.vision.fit.reference import Array, orientation


def test_flatness_of_a_built_zone() -> None:
    """Points on two parallel planes, three below and three above in a star: no closer pair of planes exists."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        turn = np.radians([0, 120, 240, 60, 180, 300])
        width = float(10.0 ** rng.uniform(-3.5, -1.0))
        height = np.array([-0.5, -0.5, -0.5, 0.5, 0.5, 0.5]) * width
        extremes = np.column_stack([100 * np.cos(turn), 100 * np.sin(turn), height])
        inner = np.column_stack([rng.uniform(-80, 80, (20, 2)), rng.uniform(-0.45, 0.45, 20) * width])
        frame, origin = orientation(rng), rng.uniform(-200, 200, 3)
        found = fit.plane_zone(np.vstack([extremes, inner]) @ frame + origin)
        assert found.zone_mm == pytest.approx(width, abs=1e-5)
        assert found.direction is not None
        assert np.linalg.norm(np.cross(found.direction, frame[2])) < 1e-7
        assert abs((found.point_mm - origin) @ frame[2]) < 1e-5


def test_roundness_of_a_built_zone() -> None:
    """Outer and inner points in alternation, four of them: the 2-2 case of the minimum zone circle."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        radius, width = float(rng.uniform(5, 100)), float(10.0 ** rng.uniform(-3.5, -1.0))
        turn = np.concatenate([np.radians([0.0, 90.0, 180.0, 270.0]), rng.uniform(0, 2 * np.pi, 20)])
        off = np.concatenate([[0.5, -0.5, 0.5, -0.5], rng.uniform(-0.45, 0.45, 20)]) * width
        local = np.column_stack([(radius + off) * np.cos(turn), (radius + off) * np.sin(turn), 0 * turn])
        frame, origin = orientation(rng), rng.uniform(-200, 200, 3)
        found = fit.circle_zone(local @ frame + origin)
        assert found.zone_mm == pytest.approx(width, abs=1e-5)
        assert np.linalg.norm(found.point_mm - origin) < 1e-4
        assert found.radius_mm == pytest.approx(radius, abs=1e-4)


def test_cylindricity_of_a_built_zone() -> None:
    """Outer and inner points in alternation at both ends: neither shift nor tilt can narrow the band."""
    rng = np.random.default_rng(3)
    for _ in range(15):
        radius, width = float(rng.uniform(5, 100)), float(10.0 ** rng.uniform(-3.5, -1.0))
        quarter = np.radians([0.0, 90.0, 180.0, 270.0])
        turn = np.concatenate([quarter, quarter, rng.uniform(0, 2 * np.pi, 30)])
        off = np.concatenate([[0.5, -0.5, 0.5, -0.5] * 2, rng.uniform(-0.45, 0.45, 30)]) * width
        height = np.concatenate([[-1.0] * 4, [1.0] * 4, rng.uniform(-1, 1, 30)]) * radius
        local = np.column_stack([(radius + off) * np.cos(turn), (radius + off) * np.sin(turn), height])
        frame, origin = orientation(rng), rng.uniform(-200, 200, 3)
        found = fit.cylinder_zone(local @ frame + origin)
        assert found.zone_mm == pytest.approx(width, abs=1e-4)
        assert found.direction is not None
        assert np.linalg.norm(np.cross(found.direction, frame[2])) < 1e-5


def brute_flatness(points: Array) -> float:
    """Width of the convex hull over all directions that three or four of the points determine."""
    best = np.inf
    for a, b, c in itertools.combinations(range(len(points)), 3):
        best = min(best, span(points, np.cross(points[b] - points[a], points[c] - points[a])))
    for (a, b), (c, d) in itertools.combinations(itertools.combinations(range(len(points)), 2), 2):
        best = min(best, span(points, np.cross(points[b] - points[a], points[d] - points[c])))
    return best


def span(points: Array, direction: Array) -> float:
    length = float(np.linalg.norm(direction))
    return float(np.ptp(points @ direction)) / length if length > 1e-9 else np.inf


def test_flatness_against_every_pair_of_support_planes() -> None:
    rng = np.random.default_rng(4)
    for _ in range(8):
        points = np.column_stack([rng.uniform(-50, 50, (9, 2)), rng.normal(0.0, 0.02, 9)]) @ orientation(rng)
        assert fit.plane_zone(points).zone_mm == pytest.approx(brute_flatness(points), abs=1e-7)


@pytest.mark.parametrize(
    ("zone", "least"), [("plane_zone", "plane"), ("circle_zone", "circle"), ("cylinder_zone", "cylinder")]
)
def test_zone_is_never_wider_than_least_squares(zone: str, least: str) -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        turn = rng.uniform(0, np.radians(200), 30)
        z = 0 * turn if least == "circle" else rng.uniform(-30, 30, 30)
        points = np.column_stack([40 * np.cos(turn), 40 * np.sin(turn), z])
        if least == "plane":
            points = np.column_stack([rng.uniform(-40, 40, (30, 2)), 0 * turn])
        points = points + rng.normal(0.0, 0.01, points.shape)
        if least == "circle":
            points[:, 2] = 0.0
        assert getattr(fit, zone)(points).zone_mm <= getattr(fit, least)(points).zone_mm * (1 + 1e-9)
