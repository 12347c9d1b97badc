"""What is used of a part that was measured at one stop of the axes. Pure, cell frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellctl.kinematics import AxesPosition
from cellctl.vision.geometry import Array
from cellctl.vision.part import PartMeasurement


@dataclass(frozen=True, slots=True)
class Seen:
    """A part seen with the axes at `at`: centre (3,) and normal (3,), clocking in rad, all in the cell.

    `step_rad` is the turn after which the part looks the same: one whole turn where an index tells its features apart.
    """

    at: AxesPosition
    centre_mm: Array
    normal: Array
    clocking_rad: float
    step_rad: float


def seen_part(part: PartMeasurement, at: AxesPosition, angles_deg: tuple[float, ...]) -> Seen:
    """What is used of a measurement in the cell frame; `angles_deg` are the pattern's own."""
    x = part.T_frame_part[:3, 0]
    step = 2.0 * np.pi / len(angles_deg) if part.clocking_free else 2.0 * np.pi
    return Seen(at, part.T_frame_part[:3, 3], part.face.normal, float(np.arctan2(x[1], x[0])), step)
