"""The true chain base -> x -> y -> jack -> table -> chuck -> shaft, for motor positions. Pure.

T_cell_shaft = Trans(x, y) Trans(jack line at z) Rz(roll at z) Rot(table axis, theta) T_chuck_shaft
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.frames import rotation_z
from hal.fake.parts import CellTruth

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motors:
    """Motor positions of the four shaft axes (mm, deg) and the sign of each linear axis' last motion."""

    x_mm: float
    y_mm: float
    z_mm: float
    theta_deg: float
    directions: tuple[float, float, float] = (1.0, 1.0, 1.0)


def true_linear_mm(cell: CellTruth, axis: int, motor_mm: Array, direction: float | Array) -> Array:
    """True travel of linear axis 0, 1, 2 (x, y, jack): scale error and half the backlash against the last motion."""
    return np.asarray(motor_mm * (1.0 + cell.scale[axis]) - 0.5 * cell.backlash_mm[axis] * direction)


def true_theta_rad(cell: CellTruth, motor_deg: float) -> float:
    """True angle of the table: its encoder is eccentric."""
    theta = math.radians(motor_deg)
    return theta + cell.encoder_amplitude_rad * math.sin(theta + cell.encoder_phase_rad)


def jack_errors(cell: CellTruth, z_mm: Array, stroke_mm: float) -> tuple[Array, Array]:
    """Lateral drift (..., 2) in mm and roll (...) in rad of the jack at true heights `z_mm`; zero at height 0."""
    height = np.asarray(z_mm, dtype=np.float64)
    waves = np.sin(0.5 * math.pi * height[..., None] / stroke_mm * np.array([1.0, 3.0, 5.0]))
    drift = height[..., None] * cell.jack_slope + waves @ cell.straightness_mm
    return drift, waves @ cell.roll_rad


def T_cell_table(cell: CellTruth, at: Motors, z_mm: Array, stroke_mm: float) -> Array:
    """(..., 4, 4) of everything below the chuck, at true jack heights `z_mm` (...)."""
    theta = true_theta_rad(cell, at.theta_deg)
    height = np.asarray(z_mm, dtype=np.float64)
    drift, roll = jack_errors(cell, height, stroke_mm)
    spin = _about(cell.table_direction, theta)
    # Runout: the table's centre walks on a circle as it turns.
    walk = rotation_z(theta)[:2, :2] @ cell.runout_mm - cell.runout_mm
    offset = cell.table_point_mm - spin @ cell.table_point_mm + np.array([*walk, 0.0])
    rolled = rotation_z(roll)
    shift = np.empty((*height.shape, 3))
    x = float(true_linear_mm(cell, 0, np.array(at.x_mm), at.directions[0]))
    y = float(true_linear_mm(cell, 1, np.array(at.y_mm), at.directions[1]))
    shift[..., 0] = drift[..., 0] + x * cell.stage[0, 0] + y * cell.stage[1, 0]
    shift[..., 1] = drift[..., 1] + x * cell.stage[0, 1] + y * cell.stage[1, 1]
    shift[..., 2] = height
    matrix = np.zeros((*height.shape, 4, 4))
    matrix[..., :3, :3] = rolled @ spin
    matrix[..., :3, 3] = shift + rolled @ offset
    matrix[..., 3, 3] = 1.0
    return matrix


def _about(direction: Array, angle_rad: float) -> Array:
    """(3, 3) rotation about the unit `direction` (Rodrigues)."""
    x, y, z = direction / np.linalg.norm(direction)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle_rad) * cross + (1.0 - math.cos(angle_rad)) * cross @ cross)
