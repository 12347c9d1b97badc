"""The spigot's press fit and the faces' coming together. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.geometry import JointGeometry

Array = NDArray[np.float64]


def press_pressure_n_per_mm2(geometry: JointGeometry, interference: float, modulus_n_per_mm2: float) -> float:
    """Contact pressure of two rings of one material (Lame): the flange outside, the hollow spigot inside.

    p = delta E / (D (c_o + c_i)), c = (R^2 + r^2) / (R^2 - r^2) of each ring; the Poisson terms cancel.
    """
    if interference <= 0.0:
        return 0.0
    joint, outer, inner = geometry.spigot_diameter_mm, geometry.face_outer_diameter_mm, geometry.bore_diameter_mm
    c_outer = (outer**2 + joint**2) / (outer**2 - joint**2)
    c_inner = (joint**2 + inner**2) / (joint**2 - inner**2)
    return interference * modulus_n_per_mm2 / (joint * (c_outer + c_inner))


def press_slope_n_per_mm(
    geometry: JointGeometry, interference: float, modulus_n_per_mm2: float, friction: float
) -> float:
    """Axial force per millimetre of engaged length while pressing in: mu p pi D."""
    pressure = press_pressure_n_per_mm2(geometry, interference, modulus_n_per_mm2)
    return friction * pressure * math.pi * geometry.spigot_diameter_mm


@dataclass(frozen=True, slots=True)
class Faces:
    """Two annular faces, tilted by `tilt_rad` when free, that align against the chuck's tilt stiffness."""

    tilt_rad: float
    radius_mm: float
    stiffness_nmm_per_rad: float

    @property
    def touch_gap_mm(self) -> float:
        """Mean gap at which the high point touches."""
        return self.radius_mm * abs(self.tilt_rad)

    def force_n(self, gap_mm: Array) -> Array:
        """Axial force that holds the mean gap at `gap_mm` (..., >= 0): moment k (tau - alpha) at the rim's lever."""
        missing = np.maximum(self.touch_gap_mm - gap_mm, 0.0)
        return np.asarray(self.stiffness_nmm_per_rad / self.radius_mm**2 * missing)

    def share_of_tilt(self, gap_mm: float) -> float:
        """Present over free tilt at the mean gap `gap_mm`: 1 until the high point touches, 0 when seated."""
        if self.touch_gap_mm == 0.0:
            return 1.0
        return min(max(gap_mm, 0.0) / self.touch_gap_mm, 1.0)
