"""Rows of a least-squares problem freed from the noise that neighbouring pixels share.

Every point keeps what the points before it in its neighbourhood do not already tell (Vecchia, J. R. Stat. Soc. B 50
(1988) 297). On a grid the neighbourhood is one stencil; which of its places are filled is a pattern that many points
share, so that few small systems are solved whatever the number of points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cellctl.vision.geometry import Array

Indices = NDArray[np.intp]
PLACES = 14
_BACK = 4


@dataclass(frozen=True, slots=True)
class Stencil:
    """`free` (N, N) sparse: from each point what the points before it tell, over the standard deviation of the rest."""

    free: csr_array

    @classmethod
    def of(
        cls, pixels: Indices, group: Indices, correlation: Callable[[Array], Array], *, places: int = PLACES
    ) -> Stencil:
        """For points at `pixels` (N, 2), all different, of one `group` (N,) each; groups do not speak for each other.

        `correlation` maps squared distances in pixels (> 0) to the correlation of the noise there.
        """
        offsets = _offsets(places)
        found = neighbours(pixels, offsets)
        there = (found >= 0) & (group[found] == group)
        pattern = (1 << np.arange(places)) @ there
        present = np.bincount(pattern, minlength=1 << places) > 0
        kinds, kind = np.flatnonzero(present), (np.cumsum(present) - 1)[pattern]
        filled = (kinds[:, None] >> np.arange(places)) & 1 == 1
        apart = np.square(offsets[:, None] - offsets[None]).sum(axis=2).astype(np.float64)
        matrix = np.where(apart > 0, correlation(np.maximum(apart, 1.0)), 0.0)
        matrix = matrix * (filled[:, :, None] & filled[:, None]) + np.eye(places)
        side = correlation(np.square(offsets).sum(axis=1).astype(np.float64)) * filled
        shares = np.linalg.solve(matrix, side[:, :, None])[:, :, 0]
        left = np.sqrt(np.maximum(1.0 - np.einsum("pk,pk->p", shares, side), 1e-6))
        count = len(pixels)
        itself = np.arange(count, dtype=np.int32)[None]  # stands for places that are not filled, whose share is zero
        columns = np.concatenate([np.where(there, found, itself), itself]).T
        values = (np.column_stack([-shares, np.ones(len(left))]) / left[:, None]).take(kind, axis=0)
        starts = (places + 1) * np.arange(count + 1, dtype=np.int32)
        return cls(csr_array((values.ravel(), columns.ravel(), starts), shape=(count, count)))

    def apply(self, rows: Array) -> Array:
        """Independent rows (q, N) of unit variance from correlated ones."""
        return np.ascontiguousarray((self.free @ rows.T).T)

    def back(self, rows: Array) -> Array:
        """The transpose of `apply`: how much each correlated point (q, N) weighs in sums over independent rows."""
        return np.asarray((self.free.T @ rows.T).T)


def _offsets(places: int) -> Indices:
    """The nearest places (k, 2) before a pixel in row order: rows above, and to the left in its own row."""
    steps = [(-i, j) for i in range(_BACK + 1) for j in range(-_BACK, _BACK + 1) if i > 0 or j < 0]
    return np.array(sorted(steps, key=lambda step: (step[0] ** 2 + step[1] ** 2, step))[:places], dtype=np.intp)


def neighbours(pixels: Indices, offsets: Indices) -> NDArray[np.int32]:
    """Row (k, N) of the point at each of the offsets (k, 2), at most a few pixels, from every point, -1 for none."""
    row, column = (side - (side.min() - _BACK) for side in np.ascontiguousarray(pixels.T))
    width = int(column.max()) + 1 + _BACK
    table = np.full((int(row.max()) + 1 + _BACK) * width, -1, dtype=np.int32)
    place = row * width + column
    table[place] = np.arange(len(place), dtype=np.int32)
    return np.asarray(table.take(place + (offsets[:, 0] * width + offsets[:, 1])[:, None]))
