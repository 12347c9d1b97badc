"""Statistical outlier removal (eq. 2-3 of the paper, corrected). Robust fits need none: it stays a recipe option.

It takes a quarter of the outliers, but also parts of bores and hole walls, whose points stand apart in a view.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cellctl.vision.geometry import Points

GRID_SPREAD = 0.2


def keep_mask(
    points: Points, *, neighbours: int = 8, factor: float = 3.0, sides: Literal["one_sided", "two_sided"] = "one_sided"
) -> NDArray[np.bool_]:
    """Which of the points (N, 3), all finite, are kept: (N,) bool.

    `factor` is the number of standard deviations; `one_sided` removes only points that are too far from their
    neighbours, `two_sided` also those that are too close.
    """
    if len(points) <= neighbours:
        return np.ones(len(points), dtype=np.bool_)
    distances, _ = cKDTree(points).query(points, k=neighbours + 1)
    # eq. 2, corrected: the mean of the k distances, not their sum, is what compares with the mean over the cloud
    mean_distance = np.asarray(distances)[:, 1:].mean(axis=1)
    # a regular grid has next to no spread, and then its own rim, a quarter to a half further apart, would go
    centre = mean_distance.mean()
    spread = max(mean_distance.std(), GRID_SPREAD * centre)
    # eq. 3, one-sided by default: a point that is close to its neighbours is no outlier
    kept = mean_distance <= centre + factor * spread
    if sides == "two_sided":
        kept &= mean_distance >= centre - factor * spread
    return np.asarray(kept)


def without_outliers(
    grid: Points, *, neighbours: int = 8, factor: float = 3.0, sides: Literal["one_sided", "two_sided"] = "one_sided"
) -> Points:
    """The cloud, (N, 3) with outliers left out or (H, W, 3) with outliers made NaN."""
    valid = np.isfinite(grid).all(axis=-1)
    kept = keep_mask(grid[valid], neighbours=neighbours, factor=factor, sides=sides)
    if grid.ndim == 2:
        return grid[valid][kept]
    result = grid.copy()
    result[tuple(index[~kept] for index in np.nonzero(valid))] = np.nan
    return result
