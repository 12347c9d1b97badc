"""Transforms, frames on a plane, and the pinhole recovered from an organised cloud."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.geometry import PlaneFrame, inverse, pose, tangents, transform, unit, viewpoint, wrap_rad
from tests.vision.fit.reference import orientation
from tests.vision.parts import SHAFT
from tests.vision.synthetic import View, pose_above, render


def test_transform_round_trip() -> None:
    rng = np.random.default_rng(1)
    T = pose(orientation(rng), rng.uniform(-500, 500, 3))
    points = rng.uniform(-300, 300, (100, 3))
    assert np.abs(transform(inverse(T), transform(T, points)) - points).max() < 1e-9


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0.0, -0.8], [-0.99, 0.1, 0.1]])
def test_tangents_are_right_handed(normal: list[float]) -> None:
    n = unit(normal)
    t = tangents(n)
    assert np.allclose(np.vstack([t, n]) @ np.vstack([t, n]).T, np.eye(3))
    assert np.cross(t[0], t[1]) @ n == pytest.approx(1.0)


def test_plane_frame_follows_its_reference() -> None:
    frame = PlaneFrame.on(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    assert np.allclose(frame.axes[0], [0, 1, 0])
    points = np.random.default_rng(2).uniform(-9, 9, (20, 3))
    assert np.allclose(frame.out(frame.into(points)), points)


def test_wrap() -> None:
    assert np.allclose(
        wrap_rad(np.array([0.0, np.pi, -np.pi, 3 * np.pi, 7.0])), [0, np.pi, np.pi, np.pi, 7 - 2 * np.pi]
    )


def test_unit_needs_a_length() -> None:
    with pytest.raises(ValueError):
        unit([0.0, 0.0, 0.0])


def test_pinhole_is_found_in_any_frame() -> None:
    rng = np.random.default_rng(3)
    grid = render(View(SHAFT, pose_above(), pixels=200), rng)
    T = pose(orientation(rng), np.array([30.0, -20.0, 400.0]))
    moved = transform(T, grid.astype(np.float64))
    found, carried = viewpoint(grid), viewpoint(moved)
    assert found is not None and np.linalg.norm(found) < 1e-3
    assert carried is not None and np.linalg.norm(carried - T[:3, 3]) < 1e-3


def test_no_pinhole_where_there_is_none() -> None:
    rng = np.random.default_rng(4)
    grid = render(View(SHAFT, pose_above(), pixels=150), rng)
    assert viewpoint(grid + rng.normal(0.0, 0.5, grid.shape).astype(np.float32)) is None
    flat = np.dstack([*np.meshgrid(np.arange(50.0), np.arange(50.0)), np.full((50, 50), 300.0)])
    assert viewpoint(flat) is None
    assert viewpoint(np.full((50, 50, 3), np.nan)) is None
