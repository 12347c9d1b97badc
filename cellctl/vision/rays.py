"""A list of points that was a camera's grid gets its grid back, so that neighbours in the view are known again.

Noise along the ray leaves every point on the ray of its pixel: seen from the pinhole, x/z and y/z of a camera whose
lens is rectified take evenly spaced values. From any other place they do not, so what is found is not guessed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SAMPLE, LEAST_POINTS, LEAST_LINES = 20_000, 2_000, 50
NEAREST_MM = 1.0
ON_RAY = 0.15
"""Distance from its ray, in pixels, at which a point is still on it: what rounding in a file may do."""
EMPTY = 8
"""Pixels per point up to which a grid is worth its memory."""

Points = NDArray[np.float32]


def regridded(points: Points, rng: np.random.Generator) -> Points:
    """The grid (H, W, 3), NaN where it has no point, that a list (N, 3) came from; the list where none shows.

    The pinhole must be the origin and look along z. Points may be NaN.
    """
    if np.isnan(points[:, 2]).any():
        points = points[~np.isnan(points[:, 2])]
    depth = points[:, 2]
    if len(points) < LEAST_POINTS or not np.abs(depth).min() > NEAREST_MM or np.ptp(np.sign(depth)) > 0:
        return points
    chosen = rng.integers(0, len(points), SAMPLE)
    rays = [points[:, axis] / depth for axis in (0, 1)]
    lines = [_lines(np.sort(ray[chosen]).astype(np.float64)) for ray in rays]
    at = [_pixels(ray, *line) if line is not None else None for ray, line in zip(rays, lines, strict=True)]
    if at[0] is None or at[1] is None:
        return points
    columns, rows = at[0], at[1]
    width, height = int(columns.max()) + 1, int(rows.max()) + 1
    if height * width > EMPTY * len(points):
        return points
    pixels = rows * width + columns
    grid = np.full((height * width, 3), np.nan, dtype=np.float32)
    grid[pixels] = points
    if np.count_nonzero(np.isfinite(grid[:, 0])) < len(points):  # two points in a pixel: two views in one list
        return points
    return grid.reshape(height, width, 3)


def _lines(values: NDArray[np.float64]) -> tuple[float, float] | None:
    """First value and pitch of the lines that sorted values lie on, None where they do not."""
    gaps = np.diff(values)
    wide = np.quantile(gaps, 1.0 - LEAST_LINES / len(gaps))
    if not wide > 0.0:
        return None
    steps = np.rint(gaps / np.median(gaps[gaps > 0.5 * wide]))
    number = np.cumsum(steps)
    if number[-1] < LEAST_LINES or np.mean(steps > 0) > 0.5:  # next to no two points on one line
        return None
    pitch, first = np.polyfit(number, values[1:], 1)
    return float(first), float(pitch)


def _pixels(ray: NDArray[np.float32], first: float, pitch: float) -> NDArray[np.intp] | None:
    """Number (N,) of the line each value lies on, from 0, None where one lies beside."""
    place = (ray - np.float32(first)) / np.float32(pitch)
    nearest = np.rint(place)
    if not np.abs(place - nearest).max() < ON_RAY:
        return None
    return np.asarray(nearest - nearest.min()).astype(np.intp)
