"""A mandrel (a cylinder) between three gap probes: where it stands, how the probes look at it. Pure, cell frame.

Probe i at angle a_i reads tip_i - c.u_i - sqrt(r^2 - (c x u_i)^2) for the mandrel's centre c, u_i = (cos a_i, sin a_i).
Steps of the stage tell which way each probe looks; two angles of the table tell the mandrel's own lean, which turns
with it, from the way of the jack (reversal).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cellctl.kinematics import AxesPosition
from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused

PROBE_ANGLES_DEG = (0.0, 120.0, 240.0)
WORST_RESIDUAL_MM = 0.01
WORST_ANGLE_DEG = 15.0
WORST_STEP = 0.2


@dataclass(frozen=True, slots=True)
class Probed:
    """Readings (3,) of the probes in mm with the axes at `at`."""

    at: AxesPosition
    gap_mm: Array


def centre_of(gap_mm: Array) -> Array:
    """(2,) where the mandrel stands off the middle, from three readings (3,), for probes at their nominal angles."""
    angle = np.radians(PROBE_ANGLES_DEG)
    return np.asarray(-2.0 / 3.0 * np.array([np.cos(angle), np.sin(angle)]) @ (gap_mm - gap_mm.mean()))


def bundle(
    probed: Sequence[Probed], row: NDArray[np.intp], stage: tuple[Array, Array], radius_mm: float
) -> tuple[Array, Array, float]:
    """All at once: probes' angles (3) and tips (3), mandrel's foot (2) and lean (2), path (2 per height but the first).

    Returns the solution, its covariance, the rms of the readings.
    """
    theta = np.radians([one.at.theta_deg for one in probed])
    spin = np.stack([np.stack([np.cos(theta), -np.sin(theta)], 1), np.stack([np.sin(theta), np.cos(theta)], 1)], 1)
    moved = np.array([one.at.x_mm * stage[0][:2] + one.at.y_mm * stage[1][:2] for one in probed])
    height = np.array([one.at.z_mm for one in probed])
    read = np.array([one.gap_mm for one in probed])

    def misses(values: Array) -> Array:
        path = np.vstack([np.zeros(2), values[10:].reshape(-1, 2)])[row]
        foot = values[6:8] - height[:, None] * values[8:10]
        centre = moved + path + np.einsum("kij,kj->ki", spin, foot)
        u = np.column_stack([np.cos(values[:3]), np.sin(values[:3])])
        along = centre @ u.T
        across = np.outer(centre[:, 1], u[:, 0]) - np.outer(centre[:, 0], u[:, 1])
        told = values[3:6] + radius_mm - along - np.sqrt(np.maximum(radius_mm**2 - across**2, 1.0))
        return np.asarray((told - read).ravel())

    start = np.zeros(10 + 2 * int(row.max()))
    start[:3], start[3:6] = np.radians(PROBE_ANGLES_DEG), read.mean(axis=0)
    scale = np.ones_like(start)
    scale[8:10] = 1e-3
    found = least_squares(misses, start, x_scale=scale, method="trf", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    free = read.size - start.size
    if free < 6:
        raise Refused("geometry_too_weak", f"{read.size} readings for {start.size} unknowns")
    variance = float(found.fun @ found.fun) / free
    jacobian = np.asarray(found.jac, dtype=np.float64)
    covariance = variance * free / (free - 2) * np.linalg.inv(jacobian.T @ jacobian)
    return np.asarray(found.x), np.asarray(covariance), float(np.sqrt(variance))


def check_unit(probed: Sequence[Probed], row: NDArray[np.intp]) -> None:
    """The probes must see the steps of the stage as large as they are."""
    first = probed[0].at.theta_deg
    below = [one for one, k in zip(probed, row, strict=True) if k == 0 and abs(one.at.theta_deg - first) < 1.0]
    steps = np.array([[one.at.x_mm, one.at.y_mm] for one in below])
    seen = np.array([centre_of(one.gap_mm) for one in below])
    steps, seen = steps - steps.mean(axis=0), seen - seen.mean(axis=0)
    size = float(np.sqrt(np.sum(seen**2) / np.sum(steps**2)))
    if not abs(size - 1.0) <= WORST_STEP:
        raise Refused("wrong_unit", f"the probes see {size:.3g} mm for each mm that the stage steps")


def check_probes(angles: Array, residual_mm: float) -> None:
    off = np.degrees(angles) - np.array(PROBE_ANGLES_DEG)
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) > WORST_ANGLE_DEG:
        raise Refused(
            "probes_swapped",
            f"probe {worst + 1} looks {off[worst]:+.0f} deg off its place (limit {WORST_ANGLE_DEG:.0f} deg)",
        )
    if residual_mm > WORST_RESIDUAL_MM:
        raise Refused(
            "residual_too_large",
            f"the probes are {residual_mm:.4f} mm rms off a round mandrel (limit {WORST_RESIDUAL_MM} mm)",
        )
