"""Axis of the table, from poses of one part that it turns. Pure, cell frame.

The part's own place does not matter: its centre walks on a circle about the axis as the table turns, its normal on a
cone about the axis' direction. All of it linear for an axis that stands nearly upright.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellctl.calibrating.seen import Seen
from cellctl.docking.ripple import correlation
from cellctl.vision.geometry import Array, wrap_rad
from cellctl.vision.part import Refused

LEAST_ANGLES, LEAST_SPAN_DEG = 6, 180.0
WORST_RESIDUAL_MM, WORST_RESIDUAL_DEG = 0.05, 0.02
WORST_TILT_DEG = 1.0
"""Beyond these the part has moved in the chuck, the stops say too little, or a unit is wrong."""


@dataclass(frozen=True, slots=True)
class TableAxis:
    """Where the axis meets the height of the part's face, and its direction; `covariance` (4, 4): place x, y (mm) and
    turns about cell x and y (deg). `encoder_deg` is the rms of the angle error that comes back with each turn,
    `angle_deg` of what is left beside it; residuals are rms per axis."""

    point_mm: Array
    direction: Array
    covariance: Array
    encoder_deg: float
    angle_deg: float
    residual_mm: float
    residual_deg: float


def table_axis(turned: Sequence[Seen], view: tuple[Array, Array], ripple: tuple[float, float]) -> TableAxis:
    """From the same part at six angles and more, stage and jack standing.

    `view` is the place (3,) of the scanner and the covariance (6, 6) of its pose as `ViewCalibration.covariance`;
    `ripple` its sigma in mm and the mean radius of the part's face. Raises Refused geometry_too_weak,
    residual_too_large.
    """
    theta = np.radians([seen.at.theta_deg for seen in turned])
    span = float(np.degrees(np.ptp(theta))) if len(theta) else 0.0
    if len(turned) < LEAST_ANGLES or span < LEAST_SPAN_DEG:
        raise Refused(
            "geometry_too_weak",
            f"{len(turned)} angles over {span:.0f} deg; at least {LEAST_ANGLES} over {LEAST_SPAN_DEG:.0f} are needed",
        )
    place, place_cov, residual_mm = _circle(theta, np.array([seen.centre_mm[:2] for seen in turned]))
    lean = np.array([seen.normal[:2] / seen.normal[2] for seen in turned])
    slope, slope_cov, residual = _circle(theta, lean)
    _check(residual_mm, float(np.degrees(residual)), slope)
    direction = np.array([*slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
    # A turn about x leans the axis towards -y, one about y towards +x.
    turns = np.array([[0.0, -1.0], [1.0, 0.0]])
    lean_cov = turns @ (slope_cov + np.eye(2) * _face_tilt(*ripple) ** 2) @ turns.T
    height = float(np.mean([seen.centre_mm[2] for seen in turned]))
    point = np.array([*place, height])
    covariance = _with_view(place_cov, lean_cov, point, view)
    encoder, angle = _angles(theta, turned)
    return TableAxis(point, direction, covariance, encoder, angle, residual_mm, float(np.degrees(residual)))


def _circle(theta: Array, places: Array) -> tuple[Array, Array, float]:
    """Centre (2,) of points (k, 2) = centre + R(theta) arm, its covariance (2, 2), rms residual per axis."""
    c, s = np.cos(theta), np.sin(theta)
    one, zero = np.ones_like(c), np.zeros_like(c)
    rows = np.stack([np.stack([one, zero, c, -s], axis=1), np.stack([zero, one, s, c], axis=1)], axis=1)
    matrix, values = rows.reshape(-1, 4), places.ravel()
    solution, *_ = np.linalg.lstsq(matrix, values, rcond=None)
    free = len(values) - 4
    variance = float(np.sum((values - matrix @ solution) ** 2)) / free
    # Few degrees of freedom: the variance of Student's distribution.
    covariance = variance * free / (free - 2) * np.linalg.inv(matrix.T @ matrix)
    return solution[:2], covariance[:2, :2], float(np.sqrt(variance))


def _check(residual_mm: float, residual_deg: float, slope: Array) -> None:
    if residual_mm > WORST_RESIDUAL_MM or residual_deg > WORST_RESIDUAL_DEG:
        raise Refused(
            "residual_too_large",
            f"centre and normal are {residual_mm:.3f} mm and {residual_deg:.4f} deg rms off circle and cone (limits "
            f"{WORST_RESIDUAL_MM} mm, {WORST_RESIDUAL_DEG} deg): the part moves in the chuck or the angle is wrong",
        )
    tilt = float(np.degrees(np.hypot(*slope)))
    if tilt > WORST_TILT_DEG:
        raise Refused("residual_too_large", f"the axis leans by {tilt:.2f} deg (limit {WORST_TILT_DEG} deg)")


def _face_tilt(sigma_mm: float, radius_mm: float) -> float:
    """Tilt (rad, one sigma per axis) that ripple gives a ring: the same in each scan, as the ring stays where it is."""
    angle = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    ring = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    weights = 2.0 * np.cos(angle) / (len(angle) * radius_mm)
    alike = correlation(np.linalg.norm(ring[:, None] - ring[None], axis=2))
    return sigma_mm * float(np.sqrt(weights @ alike @ weights))


def _with_view(place: Array, lean: Array, point: Array, view: tuple[Array, Array]) -> Array:
    """(4, 4) with what an error of the view's pose does to the axis: it carries all that is seen."""
    scanner, view_covariance = view
    x, y, z = np.radians(1.0) * (point - scanner)
    carried = np.zeros((4, 6))
    carried[:2, :3] = [[0.0, z, -y], [-z, 0.0, x]]
    carried[:2, 3:5] = np.eye(2)
    carried[2:, :2] = np.eye(2)
    own = np.zeros((4, 4))
    own[:2, :2] = place
    own[2:, 2:] = np.degrees(np.degrees(lean))
    return np.asarray(own + carried @ view_covariance @ carried.T)


def _angles(theta: Array, turned: Sequence[Seen]) -> tuple[float, float]:
    """Rms (deg) of the wave over one turn in encoder minus clocking, and of what is left beside it."""
    step = turned[0].step_rad
    seen = np.array([one.clocking_rad for one in turned])
    off = seen - theta - (seen[0] - theta[0])
    off = wrap_rad(off * (2.0 * np.pi / step)) * step / (2.0 * np.pi)
    matrix = np.column_stack([np.ones_like(theta), np.cos(theta), np.sin(theta)])
    solution, *_ = np.linalg.lstsq(matrix, off, rcond=None)
    rest = off - matrix @ solution
    left = float(np.sqrt(np.sum(rest**2) / (len(theta) - 3)))
    return float(np.degrees(np.hypot(*solution[1:]) / np.sqrt(2.0))), float(np.degrees(left))
