"""Which hole is number 0 where the places alone do not tell: each is looked at by itself for its size.

The mouths of chamfered holes look alike on the face, so that only their walls say which one is larger.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Columns
from cellctl.vision.face import Face
from cellctl.vision.geometry import Array, PlaneFrame
from cellctl.vision.outline import edge_band_mm, fit_outlines
from cellctl.vision.part import Part, Refused
from cellctl.vision.pattern import nominal, symmetry
from cellctl.vision.walls import wall_radii

OUTLINE_SHARE, CLEAR_ARC, CLOSED = 0.3, 0.75, 0.25
"""What an outline's radius is known to, in spacings; how much of it must be seen, because a torn hole looks larger than
it is; how much of a hole may be covered."""
SIZE_SIGMA, SIZE_CLIP, CLEAR_COST = 0.02, 3.0, 4.0
"""One sigma of a hole's relative size, the most that one hole counts (sigmas), by how much the best turn must win."""


def sizes_seen(near: Columns, owner: NDArray[np.intp], found: Face, part: Part) -> Array:
    """Radius (n,) of each hole by its wall, or by its outline where none is chamfered; NaN where neither shows it.

    `near` are the points around the holes in the frame of `found`, the hole of each in `owner`.
    """
    on = np.flatnonzero(np.abs(near.z) < edge_band_mm(found.plane.sigma_mm, found.spacing_mm))
    uv = np.stack([near.x[on], near.y[on]], axis=1, dtype=np.float64)
    outlines = fit_outlines(uv, owner[on], nominal(part), found.radii_mm, found.spacing_mm)
    clear = [None if item is None or item.arc < CLEAR_ARC or item.fill > CLOSED else item for item in outlines]
    if part.chamfer_diameter_mm is None:
        return np.array([np.nan if item is None else item.radius_mm for item in clear])
    centres = np.array([np.full(2, np.nan) if item is None else item.centre_mm for item in clear])
    return wall_radii(near, owner, centres, part)


def turned_by_sizes(found: Face, radii: Array, part: Part) -> Face:
    """The face with its zero angle where the radii (n,) say. Raises Refused pattern_ambiguous where they do not."""
    if not np.isfinite(radii).any():
        raise Refused("pattern_ambiguous", "no hole shows its size, which tells which one is number 0")
    order = symmetry(replace(part, diameter_mm=None))
    partners = [_partners(part, 360.0 * turn / order) for turn in range(order)]
    sigma = SIZE_SIGMA
    if part.chamfer_diameter_mm is None:  # an outline, which is known to a share of the spacing
        sigma += OUTLINE_SHARE * found.spacing_mm / float(np.nanmedian(radii))
    costs = np.array([_cost(radii, part, partner, sigma) for partner in partners])
    best = float(costs.min())
    # turns of the whole pattern, sizes included, cost the same: the smallest stands for all
    equal = order // symmetry(part)
    rivals = np.array([costs[turn::equal].min() for turn in range(equal)])
    if np.count_nonzero(rivals < best + CLEAR_COST) > 1:
        raise Refused("pattern_ambiguous", "the sizes of the holes do not tell which one is number 0")
    first = int(rivals.argmin())
    turn = min(range(first, order, equal), key=lambda item: min(item, order - item))
    angle = 2.0 * np.pi * turn / order
    c, s = np.cos(angle), np.sin(angle)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ found.frame.axes
    radii_mm = np.empty_like(found.radii_mm)
    radii_mm[partners[turn]] = found.radii_mm
    return replace(found, frame=PlaneFrame(found.frame.origin, axes), radii_mm=radii_mm)


def _partners(part: Part, turn_deg: float) -> NDArray[np.intp]:
    """Number (n,) that each feature has once the pattern's zero lies `turn_deg` back."""
    angles = np.asarray(part.angles_deg)
    gap = np.mod(angles[:, None] + turn_deg - angles[None] + 180.0, 360.0) - 180.0
    return np.asarray(np.abs(gap).argmin(axis=1))


def _cost(radii: Array, part: Part, partners: NDArray[np.intp], sigma: float) -> float:
    """Squared misses of the sizes, in units of the relative `sigma`, with the holes numbered `partners` (n,)."""
    ratio = np.log(2.0 * radii / np.asarray(part.diameter_mm)[partners])
    ratio = ratio[np.isfinite(ratio)]
    if not len(ratio):
        return 0.0
    return float((np.minimum(np.abs(ratio - np.median(ratio)) / sigma, SIZE_CLIP) ** 2).sum())
