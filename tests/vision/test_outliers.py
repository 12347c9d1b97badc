"""Statistical outlier removal: what it takes and what it leaves."""

from __future__ import annotations

import numpy as np

from cellctl.vision.outliers import keep_mask, without_outliers


def sheet(rng: np.random.Generator) -> np.ndarray:
    return np.column_stack([*(axis.ravel() * 0.5 for axis in np.mgrid[0:80, 0:80]), rng.normal(0.0, 0.03, 6400)])


def test_a_clean_surface_keeps_99_percent() -> None:
    """The sum of k distances, as the paper has it, would delete nearly all of this."""
    assert keep_mask(sheet(np.random.default_rng(1))).mean() > 0.99


def test_strays_go() -> None:
    rng = np.random.default_rng(2)
    strays = np.column_stack([rng.uniform(0, 40, (60, 2)), rng.uniform(5, 30, 60)])
    kept = keep_mask(np.vstack([sheet(rng), strays]))
    assert kept[-60:].mean() < 0.1 and kept[:-60].mean() > 0.99


def test_two_sided_also_takes_what_is_too_close() -> None:
    rng = np.random.default_rng(3)
    clump = np.array([20.25, 20.25, 0.0]) + rng.normal(0.0, 0.001, (12, 3))
    cloud = np.vstack([sheet(rng), clump])
    assert keep_mask(cloud)[-12:].all()
    assert not keep_mask(cloud, sides="two_sided")[-12:].any()


def test_a_grid_keeps_its_shape() -> None:
    grid = sheet(np.random.default_rng(4)).reshape(80, 80, 3)
    grid[10, 10, 2] = 25.0
    grid[20, 20] = np.nan
    result = without_outliers(grid)
    assert result.shape == grid.shape
    assert np.isnan(result[10, 10]).all() and np.isnan(result[20, 20]).all()
    assert np.isfinite(result).all(axis=2).sum() > 0.99 * 6400
