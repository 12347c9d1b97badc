"""Transforms and frames on a plane."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.geometry import PlaneFrame, inverse, pose, tangents, transform, unit, wrap_rad
from tests.vision.fit.reference import orientation


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
