"""Line of the jack over its whole stroke, from three gap probes beside a mandrel that it carries. Pure, cell frame.

The jack travels where no camera can stand, so a mandrel (a cylinder, longer than the stroke) rises past three probes
at one height. What the probes see moves by the jack's drift, by the lean of the table's axis and by the mandrel's own
lean, which turns with the table: two angles tell it apart (`cellctl.calibrating.mandrel`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.calibrating.mandrel import Probed, bundle, check_probes, check_unit
from cellctl.calibrating.table import TableAxis
from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused

LEAST_HEIGHTS, LEAST_STROKE_MM = 5, 100.0
WORST_TILT_DEG = 0.5
WORST_STRAIGHTNESS_MM = 0.1
SAME_MM = 0.5


@dataclass(frozen=True, slots=True)
class JackLine:
    """`direction` of the least-squares line through the start; `covariance` (2, 2) of its turns about cell x, y (deg).

    `straightness_mm` is the rms per axis of the path (k, 2) `path_mm` at `heights_mm` off that line; `residual_mm` the
    rms of the readings.
    """

    direction: Array
    covariance: Array
    straightness_mm: float
    heights_mm: Array
    path_mm: Array
    residual_mm: float


def jack_line(probed: Sequence[Probed], stage: tuple[Array, Array], axis: TableAxis, *, radius_mm: float) -> JackLine:
    """From readings at five heights and more, each at two angles half a turn apart, and steps of the stage.

    `stage` are its directions (3,). Raises Refused geometry_too_weak, residual_too_large, wrong_unit,
    probes_swapped.
    """
    heights, row = _heights(np.array([one.at.z_mm for one in probed]))
    _require(probed, heights)
    check_unit(probed, row)
    solution, covariance, residual = bundle(probed, row, stage, radius_mm)
    check_probes(solution[:3], residual)
    path = np.vstack([np.zeros(2), solution[10:].reshape(-1, 2)])
    travel = heights - heights[0]
    # What the probes see at one height of the bench leans back as the jack rises: the axis' own lean is given back.
    lean = axis.direction[:2] / axis.direction[2]
    drift = path + lean * travel[:, None]
    weight = travel / float(travel @ travel)
    slope = weight @ drift
    fold = np.kron(weight[1:], np.eye(2))
    turns = np.array([[0.0, -1.0], [1.0, 0.0]])
    own = turns @ fold @ covariance[10:, 10:] @ fold.T @ turns.T
    off = drift - travel[:, None] * slope
    straightness = float(np.sqrt(np.sum(off**2) / (2 * (len(heights) - 2))))
    tilt = float(np.degrees(np.hypot(*slope)))
    if tilt > WORST_TILT_DEG or straightness > WORST_STRAIGHTNESS_MM:
        raise Refused(
            "residual_too_large",
            f"the jack leans by {tilt:.3f} deg and strays by {straightness:.3f} mm rms (limits {WORST_TILT_DEG} deg, "
            f"{WORST_STRAIGHTNESS_MM} mm)",
        )
    direction = np.array([*slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
    total = np.degrees(np.degrees(own)) + axis.covariance[2:, 2:]
    return JackLine(direction, total, straightness, heights, drift, residual)


def _heights(z_mm: Array) -> tuple[Array, NDArray[np.intp]]:
    """Heights (k,) that were stopped at, and which of them each stop has: what is nearer than `SAME_MM` is one."""
    order = np.argsort(z_mm, kind="stable")
    row = np.empty(len(z_mm), dtype=np.intp)
    row[order] = np.concatenate([[0], np.cumsum(np.diff(z_mm[order]) > SAME_MM)])
    return np.array([z_mm[row == k].mean() for k in range(int(row.max()) + 1)]), row


def _require(probed: Sequence[Probed], heights: Array) -> None:
    if len(heights) < LEAST_HEIGHTS or np.ptp(heights) < LEAST_STROKE_MM:
        raise Refused(
            "geometry_too_weak",
            f"{len(heights)} heights over {np.ptp(heights):.0f} mm; at least {LEAST_HEIGHTS} over "
            f"{LEAST_STROKE_MM:.0f} mm are needed",
        )
    turn = np.ptp([one.at.theta_deg for one in probed])
    steps = np.ptp([[one.at.x_mm, one.at.y_mm] for one in probed], axis=0)
    if turn < 90.0 or steps.min() < 0.1:
        raise Refused(
            "geometry_too_weak", f"the mandrel turned by {turn:.0f} deg and stepped by {steps.min():.2f} mm only"
        )
