"""Where the shaft is for given axis positions: base -> x -> y -> jack -> table -> chuck -> shaft. Pure functions.

T_cell_shaft(q) = Trans(x ex + y ey) Trans(z jack_direction) Rot(table axis, theta) T_table_shaft

All with the calibration's belief; the table axis' point is the one with stage and jack at 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import Calibration

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AxesPosition:
    """Read-back of the four shaft axes: stage x, y and jack z in mm, shaft table in degrees."""

    x_mm: float
    y_mm: float
    z_mm: float
    theta_deg: float


def rotation_about(direction: Array, angle_rad: float) -> Array:
    """(3, 3) rotation by `angle_rad` about the unit `direction` (Rodrigues)."""
    axis = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross)


def T_cell_table(calibration: Calibration, at: AxesPosition) -> Array:
    """(4, 4) of everything below the chuck, for the axis positions `at`."""
    stage, axis, jack = calibration.stage, calibration.table_axis, calibration.jack_line
    jack_direction = np.array(jack.direction) / np.linalg.norm(jack.direction)
    shift = at.x_mm * np.array(stage.x_direction) + at.y_mm * np.array(stage.y_direction) + at.z_mm * jack_direction
    rotation = rotation_about(np.array(axis.direction), np.radians(at.theta_deg))
    point = np.array(axis.point_mm)
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = shift + point - rotation @ point
    return pose


def shaft_at(calibration: Calibration, T_cell_shaft: Array, measured_at: AxesPosition, at: AxesPosition) -> Array:
    """Pose (4, 4) of the shaft at `at`, given that it was `T_cell_shaft` when the axes stood at `measured_at`."""
    T_table_shaft = np.linalg.inv(T_cell_table(calibration, measured_at)) @ T_cell_shaft
    return np.asarray(T_cell_table(calibration, at) @ T_table_shaft)
