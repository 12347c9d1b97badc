"""Where points were seen from: the pinhole of an organised cloud, and the eye that the walls of holes tell alone."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.columns import Columns
from cellctl.vision.eye import over_holes, viewpoint
from cellctl.vision.geometry import inverse, pose, transform
from cellctl.vision.pattern import nominal
from tests.vision.files.scenes import hole_part, hole_scene
from tests.vision.fit.reference import orientation
from tests.vision.parts import SHAFT
from tests.vision.synthetic import View, pose_above, render


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("strays", [0.0, 0.06])
def test_the_walls_show_the_eye(seed: int, strays: float) -> None:
    rng = np.random.default_rng(seed)
    part = hole_part(rng, "equal")
    scene = hole_scene(part, rng, 500, outliers=strays)
    assert part.diameter_mm is not None and part.chamfer_diameter_mm is not None
    to_part = inverse(scene.T)
    points, walls = transform(to_part, scene.points.astype(np.float64)), 0.5 * np.asarray(part.diameter_mm)
    owner = np.hypot(*(points[:, None, :2] - nominal(part)[None]).transpose(2, 0, 1)).argmin(axis=1)
    around = np.hypot(*(points[:, :2] - nominal(part)[owner]).T) < 0.75 * part.chamfer_diameter_mm
    around &= points[:, 2] > -(part.depth_mm or 0.0)
    points, owner = (
        points[around & (points[:, 2] > -(part.depth_mm or 0.0))],
        owner[around & (points[:, 2] > -(part.depth_mm or 0.0))],
    )
    eye = over_holes(points, owner, nominal(part), walls, 1.5)
    assert eye is not None
    assert np.hypot(*(eye - to_part[:3, 3])[:2]) < 10.0
    assert over_holes(points * [1.0, 1.0, 0.0], owner, nominal(part), walls, 1.5) is None


def test_strays_show_no_eye() -> None:
    rng = np.random.default_rng(1)
    part = hole_part(rng, "equal")
    assert part.diameter_mm is not None
    size = part.diameter_mm[0]
    owner = np.repeat(np.arange(part.count), 200)
    points = rng.uniform(-size, size, (len(owner), 3)) - [0.0, 0.0, size]
    points[:, :2] += nominal(part)[owner]
    assert over_holes(points, owner, nominal(part), np.full(part.count, 0.5 * size), 1.0) is None


def test_pinhole_is_found_in_any_frame() -> None:
    rng = np.random.default_rng(3)
    grid = render(View(SHAFT, pose_above(), pixels=200), rng)
    T = pose(orientation(rng), np.array([30.0, -20.0, 400.0]))
    moved = transform(T, grid.astype(np.float64))
    found, carried = viewpoint(Columns.of(grid)), viewpoint(Columns.of(moved))
    assert found is not None and np.linalg.norm(found) < 1e-3
    assert carried is not None and np.linalg.norm(carried - T[:3, 3]) < 1e-3


def test_no_pinhole_where_there_is_none() -> None:
    rng = np.random.default_rng(4)
    grid = render(View(SHAFT, pose_above(), pixels=150), rng)
    assert viewpoint(Columns.of(grid + rng.normal(0.0, 0.5, grid.shape).astype(np.float32))) is None
    flat = np.dstack([*np.meshgrid(np.arange(50.0), np.arange(50.0)), np.full((50, 50), 300.0)])
    assert viewpoint(Columns.of(flat)) is None
    assert viewpoint(Columns.of(np.full((50, 50, 3), np.nan))) is None
