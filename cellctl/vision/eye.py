"""From where a list of points was seen, as the walls in its holes show it: a camera sees the far side of every bore."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array

HEIGHT_MM = 600.0
"""Of the eye over the face. It decides little: a ray that leans too little still meets the surface it came from."""
NEAR_WALL = 0.2
"""Distance from a wall, as a share of its radius, up to which a point may be one of it."""
AGREED, APART = 0.6, 3.0
"""How much of what the walls show must agree; how plainly their directions must differ, so that they meet at a place:
times what as many points all around would show by chance."""


def over_holes(
    points: Array, owner: NDArray[np.intp], centres: Array, radii_mm: Array, below_mm: float
) -> Array | None:
    """Eye (3,) in the frame of the face, None where the walls do not show it.

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
