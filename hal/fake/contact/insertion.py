"""The force of one insertion over the jack's height, from true geometry. Pure.

`Dock` says what meets what, `force_curve` solves contact at a grid of heights, and `ForceCurve` is looked up at the
sensor's rate. Studs are paired with the holes nearest to them, so that a pattern without index may be docked at any
of its own angles. A stud whose end meets the flange's face beyond the chamfer jams: the shaft stays and the column
yields with its axial stiffness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.contact.contact import EntryProfile
from hal.fake.contact.press import Faces
from hal.fake.frames import pose, rotation_z
from hal.fake.geometry import BenchGeometry, JointGeometry
from hal.fake.levels import Properties
from hal.fake.parts import CellTruth, RotorTruth, ShaftTruth
from hal.fake.stack import Motors, T_cell_table, true_linear_mm

Array = NDArray[np.float64]

HARDEST_STUD_N_PER_MM = 1.0e5
"""Local stiffness of thread on hole wall: what is left when the stud has no free length to bend."""
OPEN_CHUCK_SHARE = 0.1
"""Friction holds the shaft with this share of the stiffness when the jaws are open."""


@dataclass(frozen=True, slots=True)
class Dock:
    """Everything that decides the contact, at one position of stage and table.

    `offset_mm` (x, y) and `offset_deg` are added to the shaft's true pose, about the rotor's axis.
    """

    geometry: JointGeometry
    bench: BenchGeometry
    properties: Properties
    rotor: RotorTruth
    shaft: ShaftTruth
    cell: CellTruth
    motors: Motors
    slip_deg: float = 0.0
    interference_mm: float = 0.0
    """Present diametral interference of the spigot; negative is clearance."""
    circle_growth: float = 0.0
    """Relative thermal growth of the hole circle against the stud circle."""
    clamped: bool = True
    clamp_force_n: float = 0.0
    """What the nuts pull together."""
    offset_mm: tuple[float, float] = (0.0, 0.0)
    offset_deg: float = 0.0

    def T_cell_shaft(self, z_mm: Array) -> Array:
        """(..., 4, 4) true poses of the shaft, free of contact, at true jack heights `z_mm` (...)."""
        table = T_cell_table(self.cell, self.motors, z_mm, self.bench.jack_stroke_mm)
        seat = pose(rotation_z(math.radians(self.slip_deg)), np.zeros(3)) @ self.shaft.T_chuck_shaft
        if self.offset_deg == 0.0 and self.offset_mm == (0.0, 0.0):
            return np.asarray(table @ seat)
        centre = np.array([*self.rotor.T_cell_rotor[:2, 3], 0.0])
        spin = rotation_z(math.radians(self.offset_deg))
        shift = pose(spin, centre - spin @ centre + np.array([*self.offset_mm, 0.0]))
        return np.asarray(shift @ table @ seat)

    def heights_mm(self, gaps_mm: Array) -> Array:
        """True jack heights at which the faces' centres are `gaps_mm` apart."""
        at_zero = float(self.T_cell_shaft(np.array([self.bench.rotor_face_mm]))[0, 2, 3]) - self.bench.rotor_face_mm
        return np.asarray(self.bench.rotor_face_mm - at_zero - gaps_mm)

    def profile(self, holes: NDArray[np.intp]) -> EntryProfile:
        """Entry radii with stud i in hole ``holes[i]``; a hole of another size keeps its chamfer's depth."""
        geometry = self.geometry
        hole = 0.5 * self.shaft.diameter_mm[holes]
        stud = 0.5 * self.rotor.diameter_mm
        return EntryProfile(
            hole_mm=hole,
            chamfer_mm=hole + 0.5 * (geometry.hole_chamfer_diameter_mm - geometry.hole_diameter_mm),
            stud_mm=stud,
            tip_mm=stud - 0.5 * (geometry.stud_diameter_mm - geometry.stud_tip_diameter_mm),
            tan_chamfer=math.tan(math.radians(geometry.hole_chamfer_half_angle_deg)),
            tan_lead_in=math.tan(math.radians(geometry.stud_lead_in_half_angle_deg)),
        )

    def motor_mm(self, z_mm: Array) -> Array:
        """Jack motor positions of true heights `z_mm`, the other way round of `hal.fake.stack.true_linear_mm`."""
        at_zero = true_linear_mm(self.cell, 2, np.zeros(1), self.motors.directions[2])[0]
        return np.asarray((z_mm - at_zero) / (1.0 + self.cell.scale[2]))

    def true_mm(self, motor_mm: Array) -> Array:
        """True jack heights of motor positions."""
        return true_linear_mm(self.cell, 2, motor_mm, self.motors.directions[2])

    def stiffness_n_per_mm(self) -> Array:
        """(3,) what holds the shaft in x, y and tangentially."""
        held = 1.0 if self.clamped else OPEN_CHUCK_SHARE
        return np.full(3, held * self.properties.lateral_stiffness_n_per_mm)

    def faces(self) -> Faces:
        """Tilt of the two faces against each other, free."""
        normal = self.T_cell_shaft(np.array([self.bench.rotor_face_mm]))[0, :3, 2]
        tilt = math.hypot(float(normal[0]), float(normal[1]))
        stiffness = self.properties.chuck_tilt_stiffness_nmm_per_rad
        return Faces(tilt, 0.5 * self.geometry.face_outer_diameter_mm, stiffness)


@dataclass(frozen=True, slots=True)
class Meeting:
    """Axes of studs and of their holes at m heights: places (m, n, 2) are at the faces, slopes per mm of cell z."""

    stud_mm: Array
    stud_slope: Array
    hole_mm: Array
    hole_slope: Array
    gap_mm: Array
    centre_mm: Array
    holes: NDArray[np.intp]

    def offset_mm(self, depth_mm: Array) -> Array:
        """(m, n, 2) stud axis minus hole axis at `depth_mm` (m, n) below the shaft's face."""
        down = (self.gap_mm + depth_mm)[..., None]
        stud = self.stud_mm - down * self.stud_slope
        return np.asarray(stud - (self.hole_mm - depth_mm[..., None] * self.hole_slope))


def meeting(dock: Dock, z_mm: Array) -> Meeting:
    """Where studs and holes are at true heights `z_mm` (m,), thermal growth included."""
    n = dock.geometry.count
    rotor = dock.rotor.T_cell_rotor
    stud_at = np.column_stack([dock.rotor.stud_mm, np.zeros(n)]) @ rotor[:3, :3].T + rotor[:3, 3]
    stud_axis = np.column_stack([dock.rotor.slope, np.ones(n)]) @ rotor[:3, :3].T
    shaft = dock.T_cell_shaft(z_mm)
    holes = dock.shaft.hole_mm * (1.0 + dock.circle_growth)
    hole_at = np.column_stack([holes, np.zeros(n)]) @ np.swapaxes(shaft[:, :3, :3], 1, 2) + shaft[:, None, :3, 3]
    hole_axis = np.column_stack([dock.shaft.slope, np.ones(n)]) @ np.swapaxes(shaft[:, :3, :3], 1, 2)
    apart = stud_at[:, None, :2] - hole_at[-1][None, :, :2]
    pairs = np.argmin((apart * apart).sum(axis=2), axis=1)
    hole_at, hole_axis = hole_at[:, pairs], hole_axis[:, pairs]
    return Meeting(
        stud_mm=stud_at[None, :, :2],
        stud_slope=(stud_axis[:, :2] / stud_axis[:, 2:])[None],
        hole_mm=hole_at[..., :2],
        hole_slope=hole_axis[..., :2] / hole_axis[..., 2:],
        gap_mm=stud_at[None, :, 2] - hole_at[..., 2],
        centre_mm=shaft[:, :2, 3],
        holes=pairs,
    )


def bending_n_per_mm(geometry: JointGeometry, properties: Properties, lever_mm: Array) -> Array:
    """A stud as a beam loaded at `lever_mm` from the rotor's face: fixity E I / l^3, I of the stress diameter.

    d_s = d - 0.9382 P (ISO 898-1). The fixity is 3 for an end free to turn and 12 for a guided one; 12 gives an M8x1
    the design book's 8 to 23 kN/mm at 33 to 24 mm, where the studs enter.
    """
    diameter = geometry.stud_diameter_mm - 0.9382 * geometry.thread_pitch_mm
    rigidity = properties.stud_modulus_n_per_mm2 * math.pi / 64.0 * diameter**4
    beam = properties.stud_fixity * rigidity / np.maximum(lever_mm, 1.0) ** 3
    return np.asarray(np.minimum(beam, HARDEST_STUD_N_PER_MM))
