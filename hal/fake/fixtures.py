"""What goes into the chuck in place of a shaft to calibrate the cell: weights, and a mandrel under the gap probes.

The part station knows them by serial number: ``CAL-WEIGHT-40`` is 40 kg, ``CAL-MANDREL...`` the mandrel. The mandrel
is a cylinder, longer than the stroke, that stands on the table and rises with the jack past three gap probes; these are
taken from the joint and put on a bracket on the bench, at one height, looking at it from three sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.frames import child_rng

Array = NDArray[np.float64]

WEIGHT, MANDREL = "CAL-WEIGHT-", "CAL-MANDREL"
MASS_ERROR = 2e-5
"""One sigma of a weight of class M1 (OIML R 111: 5e-5 at most)."""
MANDREL_KG = 16.0
MANDREL_RADIUS_MM = 40.0
PROBES_MM = 390.0
"""Height of the bracket."""
ECCENTRICITY_MM, TILT_DEG = 0.05, 0.01
"""How true the mandrel is set up to the table's axis, one sigma per axis."""
DISTANCE_MM, DISTANCE_ERROR_MM, ANGLE_ERROR_DEG = 1.0, 0.05, 1.0
"""How the probes are set on the bracket, by hand: distance to the mandrel and direction, one sigma."""


@dataclass(frozen=True, slots=True)
class Mandrel:
    """A cylinder on the table: `foot_mm` (2,) and `slope` (2,) of its axis in the table's frame, and the probes' set.

    `angle_error_rad` and `distance_mm` (3,) are those of the probes at nominal angles 0, 120 and 240 degrees.
    """

    foot_mm: Array
    slope: Array
    angle_error_rad: Array
    distance_mm: Array

    def axis_at(self, T_cell_table: Array) -> Array:
        """(2,) where the axis passes the height of the probes."""
        foot = T_cell_table[:3, :3] @ np.array([*self.foot_mm, 0.0]) + T_cell_table[:3, 3]
        way = T_cell_table[:3, :3] @ np.array([*self.slope, 1.0])
        return np.asarray(foot[:2] + way[:2] * (PROBES_MM - foot[2]) / way[2])

    def probe_mm(self, number: int, axis_mm: Array) -> float:
        """Distance from probe 0, 1 or 2 to the cylinder, whose axis stands `axis_mm` (2,) off the bracket's middle."""
        angle = math.radians(120.0 * number) + self.angle_error_rad[number]
        out = np.array([math.cos(angle), math.sin(angle)])
        along, across = float(axis_mm @ out), float(axis_mm[1] * out[0] - axis_mm[0] * out[1])
        tip = MANDREL_RADIUS_MM + float(self.distance_mm[number])
        return tip - along - math.sqrt(MANDREL_RADIUS_MM**2 - across**2)


def draw_mandrel(seed: int, serial: str, axis_mm: Array) -> Mandrel:
    """One mandrel as it was set up to the table's axis, which is at `axis_mm` (2,)."""
    rng = child_rng(seed, "mandrel", serial)
    return Mandrel(
        foot_mm=axis_mm + rng.normal(0.0, ECCENTRICITY_MM, 2),
        slope=rng.normal(0.0, math.radians(TILT_DEG), 2),
        angle_error_rad=rng.normal(0.0, math.radians(ANGLE_ERROR_DEG), 3),
        distance_mm=rng.normal(DISTANCE_MM, DISTANCE_ERROR_MM, 3),
    )


def weight_kg(seed: int, serial: str) -> float | None:
    """True mass of a weight by serial number; None for what is no weight."""
    try:
        nominal = float(serial.removeprefix(WEIGHT)) if serial.startswith(WEIGHT) else None
    except ValueError:
        return None
    return None if nominal is None else nominal * (1.0 + MASS_ERROR * child_rng(seed, serial).standard_normal())
