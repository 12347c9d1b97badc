"""From where points were seen: as the pixels of a grid tell, or the walls in the holes of a list."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array

HEIGHT_MM = 600.0
"""Of the eye over the face. It decides little: a ray that leans too little still meets the surface it came from."""
NEAR_WALL = 0.2
"""Distance from a wall, as a share of its radius, up to which a point may be one of it."""
AGREED, APART = 0.6, 3.0
"""How much of what the walls show must agree; how plainly their directions must differ, so that they meet at a place:
times what as many points all around would show by chance."""


def viewpoint(scan: Columns, *, samples: int = 4000) -> Array | None:
    """Pinhole (3,) of an organised cloud, in the cloud's own frame, or None where there is none.

    Noise along the ray leaves the projection exact, so the camera matrix that carries points to their pixels follows
    from the cloud itself (direct linear transform); its null space is the pinhole. The answer is only given when
    pixels are met within 0.05 and the cloud has enough depth to fix it.
    """
    if scan.pixels is None or len(scan) < 200:
        return None
    some = np.s_[:: max(1, len(scan) // samples)]
    rows, columns = np.divmod(scan.pixels[some], scan.shape[1])
    points = scan.take(some).stacked()
    centre, scale = points.mean(axis=0), float(points.std()) or 1.0
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    middle, spread = pixels.mean(axis=0), float(pixels.std()) or 1.0
    x = np.column_stack([(points - centre) / scale, np.ones(len(points))])
    u = (pixels - middle) / spread
    zero = np.zeros_like(x)
    upper = np.hstack([x, zero, -u[:, :1] * x])
    lower = np.hstack([zero, x, -u[:, 1:] * x])
    matrix = np.vstack([upper, lower])
    values, vectors = np.linalg.eigh(matrix.T @ matrix)
    if values[1] < 1e-9 * values[-1]:  # all in one plane: the camera is not determined
        return None
    camera = vectors[:, 0].reshape(3, 4)
    projected = x @ camera.T
    misses = np.abs(projected[:, :2] / projected[:, 2:] - u) * spread
    if not np.median(misses) < 0.05:
        return None
    null = np.linalg.svd(camera)[2][3]
    if abs(null[3]) < 1e-9 * np.abs(null).max():
        return None
    return np.asarray(null[:3] / null[3] * scale + centre)


def over_holes(
    points: Array, owner: NDArray[np.intp], centres: Array, radii_mm: Array, below_mm: float
) -> Array | None:
    """Eye (3,) in the frame of the face, None where the walls do not show it: a camera sees the far side of every bore.

    `points` (M, 3) lie around the hole `owner` (M,); holes at `centres` (n, 2) have walls of `radii_mm` (n,) more than
    `below_mm` under the face. The directions in which the holes show their walls meet where the eye stands over the
    face: least squares of these lines, each weighed by how much wall it shows.
    """
    offset = points[:, :2] - centres[owner]
    rho = np.hypot(*offset.T)
    wall = (points[:, 2] < -below_mm) & (np.abs(rho - radii_mm[owner]) < NEAR_WALL * radii_mm[owner])
    toward = np.stack(
        [np.bincount(owner[wall], offset[wall, axis] / rho[wall], minlength=len(centres)) for axis in (0, 1)], axis=1
    )  # strays lie all around and cancel
    across = np.stack([-toward[:, 1], toward[:, 0]], axis=1)
    if not np.linalg.eigvalsh(across.T @ across)[0] > APART * np.count_nonzero(wall):
        return None
    foot = np.linalg.lstsq(across, (across * centres).sum(axis=1), rcond=None)[0]
    away = centres - foot
    away /= np.maximum(np.hypot(*away.T), 1e-9)[:, None]
    if (toward * away).sum() < AGREED * np.hypot(*toward.T).sum():
        return None
    return np.append(foot, HEIGHT_MM)
