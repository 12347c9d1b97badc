"""Nominal geometry of one joint and of the bench around it: what the drawings say. Frozen data, millimetres, degrees.

The composition root builds `JointGeometry` from the recipe; nothing here knows the controller's calibration.

Frames. Cell: z up, origin on the table axis at the height of the shaft's face with the jack at 0. Shaft part frame:
origin at the pattern's centre on the face, z the outward normal (up). Rotor part frame: origin likewise, z the outward
normal (down), so that feature i of the rotor lies at ``-angles_deg[i]`` there and meets feature i of the shaft.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class JointGeometry:
    """Drawing of the joint. Half angles are measured from the feature's axis."""

    angles_deg: tuple[float, ...]
    """Right-handed about the outward normal of the shaft's face (cell +z)."""
    circle_diameter_mm: float = 240.0
    index_feature: int | None = None

    hole_diameter_mm: float = 8.3
    hole_chamfer_diameter_mm: float = 9.9
    hole_chamfer_half_angle_deg: float = 45.0
    hole_depth_mm: float = 14.0

    stud_diameter_mm: float = 8.0
    """Crest (major) diameter."""
    stud_length_mm: float = 32.0
    stud_lead_in_half_angle_deg: float = 45.0
    thread_pitch_mm: float = 1.0
    thread_hand: Literal["right", "left"] = "right"
    thread_starts: int = 1

    face_inner_diameter_mm: float = 180.0
    face_outer_diameter_mm: float = 280.0
    ledge_step_mm: float = 5.0
    spigot_diameter_mm: float = 180.0
    spigot_length_mm: float = 3.0
    spigot_chamfer_mm: float = 0.5
    """45 degree lead-in of the spigot, radial and axial."""
    interference_mm: float = 0.06
    """Nominal diametral interference with both members at 20 C."""
    heated_member: Literal["shaft", "rotor"] = "shaft"
    expansion_per_k: float = 12.5e-6

    shaft_mass_kg: float = 100.0
    """Everything that the jack's sensor carries."""

    @property
    def bore_diameter_mm(self) -> float:
        """Bore of the rotor's spigot, the hollow inner member of the press fit: its wall is a ninth of it."""
        return 7.0 / 9.0 * self.spigot_diameter_mm

    @property
    def count(self) -> int:
        """Number of studs."""
        return len(self.angles_deg)

    @property
    def clearance_mm(self) -> float:
        """Radial clearance of a nominal stud in a nominal hole."""
        return 0.5 * (self.hole_diameter_mm - self.stud_diameter_mm)

    @property
    def stud_tip_diameter_mm(self) -> float:
        """Flat end of the stud: the lead-in goes down to the root of the thread, d3 = d - 1.22687 P (ISO 68-1)."""
        return self.stud_diameter_mm - 1.22687 * self.thread_pitch_mm

    @property
    def lead_in_mm(self) -> float:
        """Axial length of the stud's lead-in cone."""
        radial = 0.5 * (self.stud_diameter_mm - self.stud_tip_diameter_mm)
        return radial / float(np.tan(np.radians(self.stud_lead_in_half_angle_deg)))

    @property
    def chamfer_depth_mm(self) -> float:
        """Axial depth of the hole's chamfer."""
        radial = 0.5 * (self.hole_chamfer_diameter_mm - self.hole_diameter_mm)
        return radial / float(np.tan(np.radians(self.hole_chamfer_half_angle_deg)))

    @property
    def entry_gap_mm(self) -> float:
        """Gap of the faces at which the studs' ends reach the shaft's face."""
        return self.stud_length_mm

    def pattern_mm(self, side: Literal["shaft", "rotor"]) -> Array:
        """(n, 2) nominal feature positions in that side's part frame."""
        angle = np.radians(np.asarray(self.angles_deg, dtype=np.float64))
        angle = -angle if side == "rotor" else angle
        return 0.5 * self.circle_diameter_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def _looking_up() -> Array:
    pose = np.eye(4)
    pose[2, 3] = 50.0
    return pose


def _looking_down() -> Array:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 350.0
    return pose


@dataclass(frozen=True, slots=True)
class BenchGeometry:
    """Drawing of the bench: where cameras, rotor and stroke nominally are, and which volumes may not be shared."""

    rotor_face_mm: float = 400.0
    jack_stroke_mm: float = 420.0
    T_cell_camera_rotor: Array = field(default_factory=_looking_up)
    T_cell_camera_shaft: Array = field(default_factory=_looking_down)
    camera_clear_height_mm: float = 30.0
    """The shaft hits the camera's arm above this jack height unless the arm is parked."""
    gun_clear_feed_mm: float = 60.0
    """The guns hit the nuts when their table turns with the feed further out than this."""
