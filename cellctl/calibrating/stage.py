"""Directions of the stage, from a part that it carries along two lines. Pure, cell frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellctl.calibrating.seen import Seen
from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused

LEAST_STOPS, LEAST_TRAVEL_MM = 5, 4.0
WORST_RESIDUAL_MM = 0.05
WORST_SCALE = 5e-3


@dataclass(frozen=True, slots=True)
class StageAxes:
    """Unit directions (3,) of x and y, one sigma of each, how far they are from square, rms residual per axis."""

    x_direction: Array
    y_direction: Array
    sigma_direction_deg: float
    square_deg: float
    residual_mm: float


def stage_axes(stepped: Sequence[Seen], view_covariance: Array) -> StageAxes:
    """From the same part at three places and more along each axis. Raises Refused geometry_too_weak, wrong_unit,
    residual_too_large."""
    at = np.array([[seen.at.x_mm, seen.at.y_mm] for seen in stepped])
    if len(at) < LEAST_STOPS or np.ptp(at, axis=0).min() < LEAST_TRAVEL_MM:
        raise Refused("geometry_too_weak", f"the stage must travel {LEAST_TRAVEL_MM:g} mm and more along both axes")
    centres = np.array([seen.centre_mm for seen in stepped])
    matrix = np.column_stack([at, np.ones(len(at))])
    solution, *_ = np.linalg.lstsq(matrix, centres, rcond=None)
    rest = centres - matrix @ solution
    sigma = float(np.sqrt(np.sum(rest[:, :2] ** 2) / (2 * len(at) - 6)))
    lengths = np.linalg.norm(solution[:2], axis=1)
    for name, length in zip("xy", lengths, strict=True):
        if abs(length - 1.0) > WORST_SCALE:
            raise Refused(
                "wrong_unit", f"the stage moves {length:.4f} mm for each mm along {name}: unit or gear is wrong"
            )
    if sigma > WORST_RESIDUAL_MM:
        raise Refused(
            "residual_too_large",
            f"the stage is {sigma:.3f} mm rms off two lines (limit {WORST_RESIDUAL_MM} mm): the part moves",
        )
    spread = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix))[:2]).max()
    sigma_deg = float(np.hypot(np.degrees(sigma * spread), np.sqrt(np.trace(view_covariance[:3, :3]) / 3.0)))
    x, y = solution[:2] / lengths[:, None]
    square = 90.0 - float(np.degrees(np.arccos(np.clip(x @ y, -1.0, 1.0))))
    return StageAxes(x, y, sigma_deg, square, sigma)
