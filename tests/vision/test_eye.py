"""Where the eye stands over the face, told by the walls of the holes alone."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.eye import over_holes
from cellctl.vision.geometry import inverse, transform
from cellctl.vision.pattern import nominal
from tests.vision.files.scenes import hole_part, hole_scene


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
