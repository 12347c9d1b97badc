"""Noise that neighbouring pixels share: how long it is, and rows of a least-squares problem freed from it. Pure.

Model: correlation (1 - nugget) exp(-d^2 / length^2) at a distance of d pixels, estimated from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NEIGHBOURS = 6
MIN_NUGGET = 0.05
"""A Gaussian correlation without a white part would let rounding and the model's own errors decide."""


@dataclass(frozen=True, slots=True)
class Correlation:
    """`length_px` at which the correlation has fallen to 1/e of its value near zero; 0 for white noise."""

    length_px: float
    nugget: float

    def at(self, square_px: Array) -> Array:
        """Correlation at squared distances > 0."""
        if self.length_px == 0.0:
            return np.zeros_like(square_px)
        return np.asarray((1.0 - self.nugget) * np.exp(-square_px / self.length_px**2))


@dataclass(frozen=True, slots=True)
class PixelGrid:
    """Where points lie in an organised cloud: `table` holds the row of each pixel's point, -1 where there is none."""

    table: NDArray[np.int32]
    rows: Indices
    columns: Indices

    @classmethod
    def of(cls, pixels: Indices, shape: tuple[int, ...], reach: int = 4) -> PixelGrid | None:
        """From flat pixel indices (N,) into `shape`; None for a cloud that is not organised."""
        if len(shape) != 2 or min(shape) < 2 or not len(pixels):
            return None
        rows, columns = np.divmod(pixels, shape[1])
        rows, columns = rows - rows.min() + reach, columns - columns.min() + reach
        table = np.full((int(rows.max()) + 1 + reach, int(columns.max()) + 1 + reach), -1, dtype=np.int32)
        table[rows, columns] = np.arange(len(pixels), dtype=np.int32)
        return cls(table, rows.astype(np.intp), columns.astype(np.intp))

    def neighbour(self, down: int, right: int) -> NDArray[np.int32]:
        """Row of the point that lies `down`, `right` of each point, -1 where there is none."""
        return np.asarray(self.table[self.rows + down, self.columns + right])


def estimate(grid: PixelGrid, residuals: Array) -> Correlation:
    """From residuals (N,) of unit variance: correlation at one and two pixels, along rows and columns."""

    def mean(down: int, right: int) -> float:
        other = grid.neighbour(down, right)
        pairs = other >= 0
        if np.count_nonzero(pairs) < 100:
            return 0.0
        return float(np.mean(residuals[pairs] * residuals[other[pairs]]))

    power = float(np.mean(residuals**2))
    near, far = 0.5 * (mean(0, 1) + mean(1, 0)) / power, 0.5 * (mean(0, 2) + mean(2, 0)) / power
    if near < 0.1 or far <= 0.01:
        return Correlation(0.0, 1.0)
    length = float(np.clip(np.sqrt(3.0 / np.log(max(near / far, 1.1))), 0.7, 5.0))
    return Correlation(length, float(np.clip(1.0 - near * np.exp(length**-2.0), MIN_NUGGET, 0.9)))


@dataclass(frozen=True, slots=True)
class Whitener:
    """Takes from every row what its neighbours before it already tell (Vecchia, J. R. Stat. Soc. B 50 (1988) 297)."""

    neighbours: NDArray[np.int32]
    shares: Array
    spread: Array

    @classmethod
    def of(cls, grid: PixelGrid, group: Indices, correlation: Correlation) -> Whitener:
        """For points of one `group` (N,) each; groups do not speak for each other."""
        steps = [(-i, j) for i in range(4) for j in range(-3, 4) if (i > 0 or j < 0) and i * i + j * j <= 10]
        steps = sorted(steps, key=lambda step: (step[0] ** 2 + step[1] ** 2, step))
        found = np.stack([grid.neighbour(*step) for step in steps], axis=1)
        found = np.where((found >= 0) & (group[found] == group[:, None]), found, -1)
        order = np.argsort(found < 0, axis=1, kind="stable")[:, :NEIGHBOURS]
        found = np.take_along_axis(found, order, axis=1)
        places = np.array(steps, dtype=np.float64)[order]
        there = found >= 0
        square = np.sum((places[:, :, None] - places[:, None]) ** 2, axis=-1)
        matrix = correlation.at(square) * (there[:, :, None] & there[:, None])
        diagonal = np.arange(found.shape[1])
        matrix[:, diagonal, diagonal] = 1.0
        side = correlation.at(np.sum(places**2, axis=-1)) * there
        shares = np.asarray(np.linalg.solve(matrix, side[:, :, None])[:, :, 0], dtype=np.float64)
        told = np.sum(shares * side, axis=1)
        return cls(np.where(there, found, 0), shares, np.sqrt(np.maximum(1.0 - told, 1e-6)))

    def apply(self, rows: Array) -> Array:
        """Independent rows (k, N) of unit variance from correlated ones."""
        told = np.zeros_like(rows)
        for column in range(self.neighbours.shape[1]):
            told += self.shares[:, column] * rows[:, self.neighbours[:, column]]
        return np.asarray((rows - told) / self.spread)
