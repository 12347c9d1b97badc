"""The geometric elements and what a fit says about them. Millimetres; directions are unit vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMALLEST_MM = 1e-9
GREATEST_MM = 1e9
FARTHEST = 1e9
"""From the origin, in extents of the points: beyond it float64 keeps seven digits of them."""


class FitError(ValueError):
    """The points do not determine the element: too few, all alike, or in a degenerate position."""


@dataclass(frozen=True, slots=True)
class Element:
    """A fitted element.

    `kind` names it. `point_mm` (3,) lies on it: the centroid's foot on line, plane and axis, the centre of circle and
    sphere. `direction` (3,) is the line's or axis' direction, the plane's or circle's normal; its largest component
    is positive. A cone's `radius_mm` is that at `point_mm`, `apex_angle_deg` its full angle; its radius grows along
    `direction`, which therefore may point either way.
    `zone_mm` is the width of the band that holds all points: largest minus smallest signed residual, for line the
    diameter of the cylinder about it. `covariance` (p, p) is type A, in the order of `parameters`.
    """

    kind: str
    point_mm: Array
    residuals_mm: Array
    zone_mm: float
    direction: Array | None = None
    radius_mm: float | None = None
    apex_angle_deg: float | None = None
    covariance: Array | None = None
    parameters: tuple[str, ...] = ()
    iterations: int = 0
    stopped: str = ""

    @property
    def rms_mm(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals_mm**2)))


def checked(points_mm: NDArray[np.floating], least: int, dimensions: int = 2) -> Array:
    """Points (N, 3) as float64. Raises FitError: no numbers, wrong shape, not finite, fewer than `least`, spread over
    no possible length, or (where two dimensions are needed) on a line."""
    try:
        points = np.asarray(points_mm, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FitError(f"points are not numbers: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise FitError(f"points of shape {points.shape} are not (N, 3)")
    if not np.isfinite(points).all():
        raise FitError("points are not finite")
    if len(points) < least:
        raise FitError(f"{len(points)} points, at least {least} are needed")
    reach = float(np.abs(points).max())
    extent = float(np.ptp(points / reach, axis=0).max()) * reach if reach > 0.0 else 0.0
    if extent == 0.0:
        raise FitError("all points are in one place")
    if not SMALLEST_MM < extent < GREATEST_MM or reach > FARTHEST * extent:
        raise FitError(
            f"points spread over {extent:.3g} mm at up to {reach:.3g} mm from the origin: {SMALLEST_MM:g} to "
            f"{GREATEST_MM:g} mm and at least 1/{FARTHEST:g} of the distance are needed"
        )
    spread = principal(points)[1]
    if dimensions > 1 and spread[1] <= 1e-9 * spread[2]:
        raise FitError("the points lie on a line")
    return points


def signed(direction: Array) -> Array:
    """The direction with its largest component positive, so that equal data give equal signs."""
    return direction if direction[np.argmax(np.abs(direction))] > 0.0 else -direction


def frame_of(direction: Array) -> Array:
    """Rows (..., 3, 3) of a right-handed frame whose third axis is `direction` (..., 3)."""
    helper = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
    first = np.cross(helper, direction)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(direction, first), direction], axis=-2)


def principal(points: Array) -> tuple[Array, Array, Array]:
    """Centroid (3,), standard deviations (3,) ascending and their directions as rows (3, 3)."""
    centre = points.mean(axis=0)
    _, values, rows = np.linalg.svd(points - centre, full_matrices=False)
    rows = rows if len(rows) == 3 else np.vstack([rows, np.cross(rows[0], rows[1])])
    values = np.pad(values, (0, 3 - len(values)))
    return centre, values[::-1] / np.sqrt(len(points)), rows[::-1]
