"""How wide holes are, seen from their walls alone: without a model, so that a wrong size shows as what it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array
from cellctl.vision.part import Part

CLEAR_OF_CONE_MM, LEAST_ON_WALL = 0.2, 8
WITHOUT_CONE = 0.4
"""Share of the depth that a chamfer which nobody drew may take."""


def wall_radii(near: Columns, owner: NDArray[np.intp], centres_mm: Array, part: Part) -> Array:
    """Radius (n,) of each hole's wall in mm, NaN where none shows or the recipe does not tell where it would.

    `near` are points in the part's frame and `owner` the hole of each; `centres_mm` (n, 2), NaN where missing. Below
    its chamfer a hole shows nothing but its wall.
    """
    radii = np.full(part.count, np.nan)
    band = _wall(part)
    if band is None:
        return radii
    deep = np.flatnonzero((near.z > band[0]) & (near.z < band[1]))
    deep = deep[np.argsort(owner[deep].astype(np.int16), kind="stable")]
    of = owner[deep]
    square = np.square(near.x[deep] - centres_mm[of, 0]) + np.square(near.y[deep] - centres_mm[of, 1])
    starts = np.searchsorted(of, np.arange(part.count + 1))
    for k in range(part.count):
        mine = square[starts[k] : starts[k + 1]]
        if len(mine) >= LEAST_ON_WALL and np.isfinite(centres_mm[k, 0]):
            radii[k] = np.sqrt(np.median(mine))
    return radii


def _wall(part: Part) -> tuple[float, float] | None:
    """Lowest and highest place of the wall above the face, None where the recipe does not tell."""
    if part.diameter_mm is None or (part.depth_mm is None and part.chamfer_diameter_mm is None):
        return None
    deepest = 0.95 * (part.depth_mm or 1.5 * max(part.diameter_mm))
    if part.chamfer_diameter_mm is None:
        return -deepest, -WITHOUT_CONE * deepest
    slope = float(np.tan(np.radians(part.chamfer_angle_deg or 45.0)))
    return -deepest, -0.5 * (part.chamfer_diameter_mm - min(part.diameter_mm)) / slope - CLEAR_OF_CONE_MM
