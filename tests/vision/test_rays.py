"""Lists of points that were a camera's grid, and lists that were not."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.geometry import pose, transform
from cellctl.vision.measure import measure_part
from cellctl.vision.rays import regridded
from tests.vision.files.scenes import hole_part, hole_scene
from tests.vision.fit.reference import orientation


def shown(grid: np.ndarray) -> np.ndarray:
    """The rows and columns of a grid that have points."""
    there = np.isfinite(grid[..., 0])
    rows, columns = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
    return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


@pytest.mark.parametrize("seed", range(3))
def test_a_shuffled_list_gets_its_grid_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = hole_scene(hole_part(rng), rng, int(rng.integers(200, 500)))
    some = rng.permutation(scene.grid.reshape(-1, 3))  # with the pixels that have no point
    np.testing.assert_array_equal(regridded(some, rng), shown(scene.grid))
    rounded = np.round(rng.permutation(scene.points), 3).astype(np.float32)  # to a micrometre, as text files have it
    np.testing.assert_array_equal(np.isfinite(regridded(rounded, rng)), np.isfinite(shown(scene.grid)))


@pytest.mark.parametrize("seed", range(3))
def test_other_lists_stay_lists(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = hole_scene(hole_part(rng), rng, 300).points
    turned = transform(pose(orientation(rng), rng.uniform(-500.0, 500.0, 3)), points)
    level = np.column_stack([*(rng.integers(0, 200, (2, 9_000)) * 0.4 + 50.0), 350.0 + rng.normal(0.0, 0.03, 9_000)])
    others = {
        "seen from elsewhere": points + np.float32([3.0, 0.0, 0.0]),
        "in another frame": turned,
        "two views": np.concatenate([points, points + np.float32([0.0, 0.0, 1.0])]),
        "with strays": np.concatenate([points, points[:50] + np.float32(0.17)]),
        "at random": np.array([0.0, 0.0, 300.0]) + rng.uniform(-50.0, 50.0, (5_000, 3)),
        "in a plane": np.column_stack([rng.uniform(-50.0, 50.0, (5_000, 2)), np.full(5_000, 300.0)]),
        "along parallel rays": level,
        "around the origin": points - points.mean(axis=0),
        "few": points[:500],
    }
    for what, some in others.items():
        assert regridded(rng.permutation(some).astype(np.float32), rng).ndim == 2, what


def test_a_list_is_measured_as_well_as_its_grid() -> None:
    """Noise that neighbouring pixels share is taken off where the pixels are known again."""
    rng = np.random.default_rng(5)
    scene = hole_scene(hole_part(rng, "unequal"), rng, 500, correlation_px=3.0)
    of_grid, of_list = (measure_part(points, scene.part) for points in (scene.grid, rng.permutation(scene.points)))
    for one, other in zip(of_grid.features, of_list.features, strict=True):
        assert one.found and other.found
        assert one.center_mm is not None and other.center_mm is not None
        assert one.covariance_mm2 is not None and other.covariance_mm2 is not None
        sigma = np.sqrt(np.trace(one.covariance_mm2))
        assert np.linalg.norm(one.center_mm - other.center_mm) < sigma
        assert np.sqrt(np.trace(other.covariance_mm2)) < 1.2 * sigma
