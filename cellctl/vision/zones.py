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
        axis = np.square((np.arange(2 * half) - half + 0.5) * cell)
        square = axis[:, None] + axis
        margin = 2.0 * spacing_mm + 0.75 * cell
        on_face = (square > (low + margin) ** 2) & (square < max(high - margin, 0.0) ** 2)
        expected = (square > (inner + margin) ** 2) & (square < max(outer - margin, 0.0) ** 2)
        corner = np.full(2, -half * cell)
        number, distance = nearest(nominal(part), corner, cell, square.shape, float(reach_mm.max()) + cell)
        if part.feature == "hole":
            clear = distance > radii_mm[number] + margin
            on_face &= clear
            expected &= clear
        owned = distance < reach_mm[number] + 0.75 * cell
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

    def coverage(self, seen: NDArray[np.bool_]) -> float:
        """Share (0 to 1) of the face's nominal area that holds points, in blocks of about two and a half spacings;
        `seen` (n * n,) are the cells with points on the face."""
        block = max(1, round(2.5 * self.spacing_mm / self.cell_mm))
        expected = ~_any_in_blocks(~self.expected, block)
        there = _any_in_blocks(seen.reshape(self.codes.shape), block)
        return float(np.mean(there[expected])) if expected.any() else 0.0


def _any_in_blocks(bits: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Whether any bit is set in each whole block of `block` cells by as many."""
    for _ in range(2):
        size = len(bits) // block
        bits = np.asarray(bits[: size * block].reshape(size, block, -1).any(axis=1)).T
    return bits


def nearest(
    centres: Array, corner: Array, cell_mm: float, shape: tuple[int, int], reach_mm: float
) -> tuple[NDArray[np.int16], Array]:
    """Number of the nearest of the centres (n, 2) for every cell of a raster that begins at `corner` (2,), and the
    distance of the cell's middle from it; -1 and infinite where that is `reach_mm` or more."""
    number, distance = np.full(shape, -1, dtype=np.int16), np.full(shape, np.inf)
    span = int(np.ceil(reach_mm / cell_mm)) + 1
    for index, at in enumerate((centres - corner) / cell_mm):
        middle = np.floor(at).astype(np.intp)
        low, high = np.maximum(middle - span, 0), np.maximum(middle + span + 1, 0)
        u, v = ((np.arange(a, min(b, n)) + 0.5 - c) * cell_mm for a, b, n, c in zip(low, high, shape, at, strict=True))
        away, window = np.hypot(u[:, None], v), np.s_[low[0] : high[0], low[1] : high[1]]
        nearer = (away < distance[window]) & (away < reach_mm)
        distance[window][nearer], number[window][nearer] = away[nearer], index
    return number, distance


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
