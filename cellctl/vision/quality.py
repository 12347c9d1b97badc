"""Where the face should be seen, and how much of it was."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array
from cellctl.vision.part import Part
from cellctl.vision.pattern import nominal


def rims(part: Part, radii_mm: Array) -> tuple[float, float]:
    """Inner and outer radius of the face in mm; without sizes, a band of one and a half holes about the circle."""
    ring, hole = 0.5 * part.circle_diameter_mm, float(radii_mm.max())
    inner = 0.5 * part.face_inner_diameter_mm if part.face_inner_diameter_mm else max(0.0, ring - 3.0 * hole)
    outer = 0.5 * part.face_outer_diameter_mm if part.face_outer_diameter_mm else ring + 3.0 * hole
    return inner, outer


def band(part: Part, radii_mm: Array) -> tuple[float, float]:
    """Inner and outer radius (mm) between which points count as the face: the rims, wide where the recipe has none."""
    inner, outer = rims(part, radii_mm)
    if part.face_inner_diameter_mm is None:
        inner *= 0.5
    if part.face_outer_diameter_mm is None:
        outer *= 1.5
    return inner, outer


def nearness(local: Array, part: Part, radii_mm: Array, margin_mm: float) -> NDArray[np.bool_]:
    """Which points (N, 3) in the part's frame lie on the face's own area: (N,) bool.

    Inside the rims and outside the features, each by `margin_mm`.
    """
    inner, outer = band(part, radii_mm)
    rho = np.hypot(local[:, 0], local[:, 1])
    inside = (rho > inner + margin_mm) & (rho < outer - margin_mm)
    if part.feature == "hole":
        ring, reach = 0.5 * part.circle_diameter_mm, float(radii_mm.max()) + margin_mm
        close = np.flatnonzero(inside & (np.abs(rho - ring) < reach))
        angles = np.mod(np.radians(part.angles_deg), 2.0 * np.pi)
        order = np.argsort(angles)
        ordered = angles[order]
        middle = 0.5 * (ordered + np.append(ordered[1:], ordered[0] + 2.0 * np.pi))
        at = np.mod(np.arctan2(local[close, 1], local[close, 0]), 2.0 * np.pi)
        owner = order[np.searchsorted(middle, at) % part.count]
        distance = np.hypot(*(local[close, :2] - nominal(part)[owner]).T)
        inside[close[distance < radii_mm[owner] + margin_mm]] = False
    return np.asarray(inside)


def coverage(local: Array, part: Part, radii_mm: Array, spacing_mm: float, thickness_mm: float) -> float:
    """Share (0 to 1) of the face's nominal area that holds face points, in cells of two and a half spacings."""
    inner, outer = rims(part, radii_mm)
    cell = 2.5 * spacing_mm
    half = int(np.ceil(outer / cell))
    on = (np.abs(local[:, 2]) < thickness_mm) & (np.abs(local[:, :2]) < half * cell).all(axis=1)
    cells = np.floor(local[on, :2] / cell).astype(np.int64) + half
    counts = np.bincount(cells[:, 0] * 2 * half + cells[:, 1], minlength=4 * half * half)
    axis = (np.arange(2 * half) - half + 0.5) * cell
    u, v = np.meshgrid(axis, axis, indexing="ij")
    centres = np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])
    rho = np.hypot(centres[:, 0], centres[:, 1])
    expected = nearness(centres, part, radii_mm, cell) & (rho > inner) & (rho < outer)
    return float(np.mean(counts[expected] > 0)) if expected.any() else 0.0
