"""Principal components of a point cloud and its three projections (eq. 4-9). Pure.

The main axis is a start for a fit, not a result: of a half-seen stud it is some tenths of a degree off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused


@dataclass(frozen=True, slots=True)
class Principal:
    """`mean` (3,), `axes` (3, 3) with rows u1, u2, u3 by falling variance (right-handed), `variances_mm2` (3,)."""

    mean: Array
    axes: Array
    variances_mm2: Array

    def scores(self, points: Array) -> Array:
        """(n, 3) coordinates along u1, u2, u3."""
        return np.asarray((points - self.mean) @ self.axes.T)

    def projection(self, points: Array, dropped: int) -> Array:
        """(n, 2) projection along axis `dropped`: 0 gives x23 (eq. 7), 1 gives x13 (eq. 8), 2 gives x12 (eq. 9).

        Corrected: of x - mean, where the paper projects x itself.
        """
        kept = [axis for axis in range(3) if axis != dropped]
        return np.asarray((points - self.mean) @ self.axes[kept].T)


def principal(points: Array) -> Principal:
    """Principal components of points (n, 3), n >= 3. Signs are fixed: the largest component of u1 and u2 is positive.

    Raises Refused (too_few_points, not_finite).
    """
    if len(points) < 3:
        raise Refused("too_few_points", f"{len(points)} points have no principal axes")
    if not np.isfinite(points).all():
        raise Refused("not_finite", "the points are not finite")
    mean = points.mean(axis=0)
    centred = points - mean  # eq. 4
    values, vectors = np.linalg.eigh(centred.T @ centred)  # eq. 5: H = U S^2 U^T
    axes = vectors[:, ::-1].T.copy()  # eq. 6, u1 first
    for axis in axes[:2]:
        axis *= np.sign(axis[np.abs(axis).argmax()])
    axes[2] = np.cross(axes[0], axes[1])
    return Principal(mean, axes, values[::-1] / (len(points) - 1))
