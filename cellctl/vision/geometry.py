"""Rigid transforms, frames on a plane, and the point of view of an organised cloud. Pure functions, millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.float32] | NDArray[np.float64]


def transform(T_target_source: Array, points: Points) -> Array:
    """Carry points (..., 3) by the rigid transform (4, 4): p' = R p + t.

    # eq. 1, corrected: the paper only translates; the rotation belongs to it.
    """
    return np.asarray(points @ T_target_source[:3, :3].T + T_target_source[:3, 3], dtype=np.float64)


def inverse(T_target_source: Array) -> Array:
    """Inverse (4, 4) of a rigid transform, exact to rounding."""
    rotation = T_target_source[:3, :3]
    result = np.eye(4)
    result[:3, :3] = rotation.T
    result[:3, 3] = -rotation.T @ T_target_source[:3, 3]
    return result


def pose(rotation: Array, translation: Array) -> Array:
    """(4, 4) from a rotation (3, 3) and a translation (3,)."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = translation
    return result


def unit(vector: Any) -> Array:
    """`vector` (3,) at length 1. Raises ValueError for a vector of no length."""
    array = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(array))
    if not length > 0.0:
        raise ValueError("a direction needs a length")
    return array / length


def rotate(points: Array, angle_rad: float) -> Array:
    """Points (n, 2) turned about the origin by `angle_rad`, right-handed."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def carried(points: Array, model: Array, onto: Array) -> Array:
    """Points (k, 2) moved by the motion and scale that bring `model` (n, 2) nearest to `onto` (n, 2), least squares."""
    at, here, there = (places[:, 0] + 1j * places[:, 1] for places in (points, model, onto))
    arm = here - here.mean()
    moved = there.mean() + np.vdot(arm, there) / np.vdot(arm, arm) * (at - here.mean())
    return np.column_stack([moved.real, moved.imag])


def robust_sigma(residuals: Array) -> float:
    """Standard deviation of the core of `residuals` about zero, from the median of the absolute values."""
    return 1.4826 * float(median(np.abs(residuals))) if len(residuals) else 0.0


def median(values: Array, axis: int = -1) -> Array:
    """Upper median along one axis, by a single selection: of a few values several times faster than numpy's own."""
    middle = values.shape[axis] // 2
    return np.asarray(np.partition(values, middle, axis=axis).take(middle, axis=axis))


def row_medians(values: Array) -> Array:
    """Median (k,) over the finite values (k, n) of each row, NaN where there are none."""
    ordered = np.sort(values, axis=1)  # NaN come last
    counts = np.isfinite(values).sum(axis=1)
    rows = np.arange(len(values))
    return np.asarray(
        0.5 * (ordered[rows, np.maximum(counts - 1, 0) // 2] + ordered[rows, counts // 2 % values.shape[1]])
    )


def tangents(normal: Array, reference: Array | None = None) -> Array:
    """Two unit vectors (2, 3) that make a right-handed triad with `normal`: t0 x t1 = normal.

    Deterministic: t0 is the projection of `reference`, else of the x axis (of y where that is nearly along the normal).
    """
    if reference is None or abs(float(normal @ reference)) > 0.9:
        reference = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = unit(reference - (reference @ normal) * normal)
    return np.stack([first, np.cross(normal, first)])


@dataclass(frozen=True, slots=True)
class PlaneFrame:
    """Coordinates on a plane: `origin` (3,), rows of `axes` (3, 3) are u, v and the normal w (right-handed)."""

    origin: Array
    axes: Array

    @classmethod
    def on(cls, point: Array, normal: Array, reference: Array | None = None) -> PlaneFrame:
        """Frame at `point` with w along `normal` and u along the projection of `reference` (else of x)."""
        return cls(np.asarray(point, dtype=np.float64), np.vstack([tangents(normal, reference), normal]))

    def into(self, points: Points) -> Array:
        """(..., 3) -> (..., 3): u, v along the plane, w above it."""
        return np.asarray((points - self.origin) @ self.axes.T, dtype=np.float64)

    def out(self, coordinates: Array) -> Array:
        """Inverse of `into`."""
        return np.asarray(coordinates @ self.axes + self.origin)


def wrap_rad(angle: Array) -> Array:
    """Angles in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle, 2.0 * np.pi))
