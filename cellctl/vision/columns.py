"""The valid points of a cloud as three columns: a pass over a cloud that is written coordinate by coordinate.

Elementwise arithmetic on columns gives the same bits whatever the number of threads, which matrix products of tall
arrays do not promise. Points are float32 as cameras give them; sums over them are formed in float64.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array, PlaneFrame, Points

Column = NDArray[np.float32]
BATCH = 32_768


@dataclass(frozen=True, slots=True)
class Columns:
    """Coordinates `x`, `y`, `z` (N,) in mm, all finite.

    `pixels` (N,) are flat indices into the organised cloud of `shape` they come from; None for an unorganised one.
    """

    x: Column
    y: Column
    z: Column
    pixels: NDArray[np.intp] | None = None
    shape: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, points: Points) -> Columns:
        """From (N, 3), or (H, W, 3) with NaN where there is no point."""
        flat = points.reshape(-1, 3)
        valid = np.flatnonzero(flat[:, 0] == flat[:, 0])
        x, y, z = np.empty((3, len(valid)), dtype=np.float32)
        for begin in range(0, len(valid), BATCH):
            piece = flat.take(valid[begin : begin + BATCH], axis=0)
            for axis, column in enumerate((x, y, z)):
                column[begin : begin + len(piece)] = piece[:, axis]
        if points.ndim == 2:
            return cls(x, y, z)
        return cls(x, y, z, valid, (points.shape[0], points.shape[1]))

    def __len__(self) -> int:
        return len(self.x)

    def take(self, rows: NDArray[Any] | slice) -> Columns:
        """Some of the points, by index, mask (N,) or slice."""
        if not isinstance(rows, slice):
            rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
            x, y, z = (column.take(rows) for column in (self.x, self.y, self.z))
            return Columns(x, y, z, None if self.pixels is None else self.pixels.take(rows), self.shape)
        pixels = None if self.pixels is None else self.pixels[rows]
        return Columns(self.x[rows], self.y[rows], self.z[rows], pixels, self.shape)

    @classmethod
    def joined(cls, parts: list[Columns], whole: Columns) -> Columns:
        """Points out of `whole` in one piece again."""
        if not parts:
            return whole.take(np.s_[:0])
        x, y, z = (np.concatenate([getattr(part, axis) for part in parts]) for axis in "xyz")
        if whole.pixels is None:
            return cls(x, y, z)
        return cls(x, y, z, np.concatenate([part.pixels for part in parts if part.pixels is not None]), whole.shape)

    def batches(self) -> Iterator[tuple[int, Columns]]:
        """All points in turn, in pieces that stay in the processor's cache, and where each begins: what is worked out
        on the way from a point to a sum or an index need not be kept for a million points."""
        for begin in range(0, len(self), BATCH):
            yield begin, self.take(np.s_[begin : begin + BATCH])

    def into(self, frame: PlaneFrame) -> Columns:
        """The same points in the coordinates of `frame`: x, y along its plane, z above it."""
        origin = frame.origin.astype(np.float32)
        dx, dy, dz = self.x - origin[0], self.y - origin[1], self.z - origin[2]
        # what rounding took from the origin
        rest = frame.axes @ (origin - frame.origin)
        rotated = []
        for axis, shift in zip(frame.axes.astype(np.float32), rest.astype(np.float32), strict=True):
            column = dx * axis[0]
            column += dy * axis[1]
            column += dz * axis[2]
            column += shift
            rotated.append(column)
        return Columns(rotated[0], rotated[1], rotated[2], self.pixels, self.shape)

    def above(self, normal: Array, distance_mm: float) -> Column:
        """Height (N,) over the plane normal . p = distance."""
        n = normal.astype(np.float32)
        height = self.x * n[0]
        height += self.y * n[1]
        height += self.z * n[2]
        height -= np.float32(distance_mm)
        return np.asarray(height)

    def stacked(self) -> Array:
        """(N, 3), float64."""
        return np.stack([self.x, self.y, self.z], axis=1, dtype=np.float64)


def total(values: Column) -> float:
    """Sum of a column, formed in float64."""
    return float(np.add.reduce(values, dtype=np.float64))


def inner(first: Column, second: Column) -> float:
    """Sum of products of two columns, formed in float64."""
    return float(np.add.reduce(first * second, dtype=np.float64))
