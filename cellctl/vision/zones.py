"""Where the face and its features should be seen, as a raster over the face: one look-up says what a point may lie on.

Coordinates are those of the part's approximate frame: origin at the pattern's centre, x through its zero angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Column
from cellctl.vision.geometry import Array
from cellctl.vision.part import Part
from cellctl.vision.pattern import nominal

FACE = np.int16(0x4000)
"""Flag of the face's own area, clear of features and rims."""
FEATURE = np.int16(0x3FFF)
"""Mask of the feature's number plus one; 0 where none is near."""
MOST_CELLS = 400


@dataclass(frozen=True, slots=True)
class Zones:
    """Square raster of `codes` (n, n) with cells of `cell_mm` about the origin; its outermost cells are of no zone.

    `expected` (n, n) marks the face's nominal area, which coverage is counted on.
    """

    codes: NDArray[np.int16]
    expected: NDArray[np.bool_]
    cell_mm: float
    spacing_mm: float

    @classmethod
    def of(cls, part: Part, radii_mm: Array, reach_mm: Array, spacing_mm: float) -> Zones:
        """From the nominal geometry, the radii (k,) of the features' voids and of their neighbourhoods, mm."""
        inner, outer = rims(part, radii_mm)
        low, high = band(part, radii_mm)
        cell = max(spacing_mm, 2.0 * high / MOST_CELLS)
        half = int(np.ceil(high / cell)) + 2
        axis = (np.arange(2 * half) - half + 0.5) * cell
        u, v = np.meshgrid(axis, axis, indexing="ij")
        rho = np.hypot(u, v)
        margin = 2.0 * spacing_mm + 0.75 * cell
        on_face = (rho > low + margin) & (rho < high - margin)
        expected = (rho > inner + margin) & (rho < outer - margin)
        number, distance = _nearest_feature(part, u, v, rho, float(reach_mm.max()) + cell)
        near = number >= 0
        if part.feature == "hole":
            clear = ~near | (distance > radii_mm[number] + margin)
            on_face &= clear
            expected &= clear
        owned = near & (distance < reach_mm[number] + 0.75 * cell)
        codes = np.where(owned, number + 1, 0).astype(np.int16) | np.where(on_face, FACE, np.int16(0))
        for edge in (codes[0], codes[-1], codes[:, 0], codes[:, -1]):
            edge[:] = 0
        return cls(codes, expected, cell, spacing_mm)

    def cells(self, u: Column, v: Column) -> NDArray[np.int32]:
        """Number (N,) of the cell of each point; points outside fall on the raster's border."""
        n = len(self.codes)
        inverse, half = np.float32(1.0 / self.cell_mm), np.float32(n // 2)
        rows, columns = u * inverse, v * inverse
        for values in (rows, columns):
            values += half
            np.clip(values, 0.5, n - 0.5, out=values)
        cells = rows.astype(np.int32)
        cells *= np.int32(n)
        cells += columns.astype(np.int32)
        return cells

    def coverage(self, counts: NDArray[np.intp]) -> float:
        """Share (0 to 1) of the face's nominal area that holds points, in blocks of about two and a half spacings;
        `counts` (n * n,) of the points on the face in each cell."""
        n = len(self.codes)
        block = max(1, round(2.5 * self.spacing_mm / self.cell_mm))
        size = n // block
        seen = (
            counts.reshape(n, n)[: size * block, : size * block].reshape(size, block, size, block).sum(axis=(1, 3)) > 0
        )
        expected = self.expected[: size * block, : size * block].reshape(size, block, size, block).all(axis=(1, 3))
        return float(np.mean(seen[expected])) if expected.any() else 0.0


def rims(part: Part, radii_mm: Array) -> tuple[float, float]:
    """Inner and outer radius of the face in mm; without sizes, a band of one and a half holes about the circle."""
    ring, hole = 0.5 * part.circle_diameter_mm, float(radii_mm.max())
    inner = 0.5 * part.face_inner_diameter_mm if part.face_inner_diameter_mm else max(0.0, ring - 3.0 * hole)
    outer = 0.5 * part.face_outer_diameter_mm if part.face_outer_diameter_mm else ring + 3.0 * hole
    return inner, outer


def band(part: Part, radii_mm: Array) -> tuple[float, float]:
    """Inner and outer radius (mm) between which points count as the face: the rims, wide where the recipe has none."""
    inner, outer = rims(part, radii_mm)
    low = inner if part.face_inner_diameter_mm else 0.5 * inner
    high = outer if part.face_outer_diameter_mm else 1.5 * outer
    return low, high


def _nearest_feature(part: Part, u: Array, v: Array, rho: Array, reach_mm: float) -> tuple[NDArray[np.intp], Array]:
    """Number of the nearest feature of every cell within `reach_mm` of the circle, else -1, and the distance to it."""
    ring = 0.5 * part.circle_diameter_mm
    number = np.full(u.shape, -1, dtype=np.intp)
    distance = np.full(u.shape, np.inf)
    close = np.abs(rho - ring) < reach_mm
    angles = np.mod(np.radians(part.angles_deg), 2.0 * np.pi)
    order = np.argsort(angles)
    middle = 0.5 * (angles[order] + np.append(angles[order][1:], angles[order][0] + 2.0 * np.pi))
    start = middle[-1] - 2.0 * np.pi  # where the first feature's sector begins
    at = np.mod(np.arctan2(v[close], u[close]) - start, 2.0 * np.pi)
    owner = order[np.searchsorted(middle[:-1] - start, at)]
    centre = nominal(part)[owner]
    number[close] = owner
    distance[close] = np.hypot(u[close] - centre[:, 0], v[close] - centre[:, 1])
    return number, distance
