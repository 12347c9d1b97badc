"""What an alignment is asked (`AlignSpec`) and what it answers (`Alignment`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cellctl.kinematics import Array, AxesPosition
from cellctl.recipe import Recipe
from cellctl.vision.contact import ContactModel
from cellctl.vision.uncertainty import TemperatureWindow


@dataclass(frozen=True, slots=True)
class Station:
    """A place on the way in where a stud can touch its hole: at this gap of the faces, this deep in the hole.

    `entering`: the stud's end passes the chamfer there, on which it wedges; elsewhere cylinder slides on cylinder.
    """

    gap_mm: float
    depth_mm: float = 0.0
    entering: bool = False


@dataclass(frozen=True, slots=True)
class AlignSpec:
    """Parameters of an alignment, from the recipe. Lengths in mm, temperatures differences in K.

    `clearance_mm` is the radial clearance of each bolt, `position_sigma_mm` the scatter of a feature's position per
    axis. `stand_off_mm` is the gap between stud tip and hole at which the shaft waits, and the h0 of eq. 23.
    `heated` grows; `expansion_per_k` is linear. The table may turn to [theta_low_deg, theta_high_deg].
    """

    angles_deg: tuple[float, ...]
    clearance_mm: float | tuple[float, ...]
    stand_off_mm: float = 3.0
    stud_length_mm: float = 0.0
    hole_depth_mm: float = 0.0
    rim_radius_mm: float = 0.0
    heated: Literal["shaft", "rotor"] | None = None
    expansion_per_k: float = 12.5e-6
    difference_k: float = 0.0
    difference_tolerance_k: float = 0.0
    interference_mm: float = 0.0
    interference_tolerance_mm: float = 0.0
    open_by_mm: float = 0.0
    clearance_sigmas: float = 3.0
    spigot_diameter_mm: float | None = None
    position_sigma_mm: float = 0.01
    force_limit_n: float = 10.0
    theta_low_deg: float = -180.0
    theta_high_deg: float = 180.0
    contact: ContactModel = field(default_factory=ContactModel)
    samples: int = 8192
    seed: int = 0

    def stations(self) -> tuple[Station, ...]:
        """Corners of the way in, between which offsets are straight lines; seated last.

        Tip at the hole's face, tip at the hole's far end, stud at the hole's far end and at its face when seated.
        """
        length = self.stud_length_mm
        deep = min(self.hole_depth_mm, length) if length > 0 else self.hole_depth_mm
        entry = (Station(length, entering=True),) if length > 0 else ()
        through = (Station(length - deep, deep),) if 0 < deep < length else ()
        end = (Station(0.0, deep),) if deep > 0 else ()
        return (*entry, *through, *end, Station(0.0, entering=not entry))

    def clearances(self) -> Array:
        """Radial clearance (n,) of each bolt, in the order of the shaft's holes."""
        return np.array(np.broadcast_to(np.asarray(self.clearance_mm, dtype=np.float64), (len(self.angles_deg),)))


@dataclass(frozen=True, slots=True)
class Alignment:
    """The decision's basis. Corrections are target minus present, in axis coordinates; `target` is what to command.

    `target.z_mm` is the jack height at which the faces first touch, `approach_z_mm` leaves the stud tips `stand_off`
    below the holes' faces. `gap_mm` and `tilt_deg`: the faces as the shaft stood when it was scanned, and the angle
    between them at the target. Covariances (3, 3) are of (x_mm, y_mm, theta_deg) at the docking height, in mm2,
    mm deg, deg2: type A from the residuals, type B from scanner certificate, common frame and axes; `sigma_*` join
    them. `clearance_mm` per bolt, the least over the way in, cold; `clearance_hot_mm` at the docking temperature.
    `p_insert`: every bolt passes free of contact, cold; `p_insert_hot` seated at the docking temperature; `p_force_ok`
    the total contact force stays within the limit. `predicted_peak_force_n` (sum) and `predicted_peak_bolt_n` are
    95 % quantiles. `offsets_mm` (n, 2) hole minus stud at the seated station. `clocking_free`: no index proved which
    hole meets which stud; `partner[i]` is the stud that hole i meets.
    """

    x_mm: float
    y_mm: float
    theta_deg: float
    target: AxesPosition
    approach_z_mm: float
    tilt_deg: float
    gap_mm: float
    sigma_theta_deg: float
    sigma_xy_mm: float
    covariance_a: Array
    covariance_b: Array
    clearance_mm: Array
    clearance_hot_mm: Array
    p_insert: float
    p_insert_hot: float
    p_force_ok: float
    predicted_peak_force_n: float
    predicted_peak_bolt_n: float
    window: TemperatureWindow
    eps_pla: float
    eps_cyc: float
    offsets_mm: Array
    h_i_mm: Array
    h_j_mm: Array
    partner: tuple[int, ...]
    clocking_free: bool


def align_spec(recipe: Recipe, *, theta_low_deg: float = -180.0, theta_high_deg: float = 180.0) -> AlignSpec:
    """The alignment's parameters out of a recipe; the table's travel comes from the cell."""
    heat, shaft, rotor = recipe.heat, recipe.shaft, recipe.rotor
    bolts = rotor if rotor is not None and rotor.feature == "stud" else shaft
    holes = shaft if bolts is rotor else rotor
    outer = [part.face_outer_diameter_mm for part in (shaft, rotor) if part is not None and part.face_outer_diameter_mm]
    return AlignSpec(
        angles_deg=recipe.pattern.angles(),
        clearance_mm=recipe.limits.radial_clearance_mm,
        stand_off_mm=recipe.align.stand_off_mm,
        stud_length_mm=(bolts.length_mm if bolts else None) or 0.0,
        hole_depth_mm=(holes.depth_mm if holes else None) or 0.0,
        rim_radius_mm=min(outer, default=recipe.pattern.circle_diameter_mm) / 2,
        heated=heat.member if heat.enabled else None,
        expansion_per_k=heat.expansion_per_k,
        difference_k=heat.difference_k if heat.enabled else 0.0,
        difference_tolerance_k=heat.difference_tolerance_k if heat.enabled else 0.0,
        interference_mm=heat.fit_interference_mm,
        interference_tolerance_mm=heat.fit_tolerance_mm,
        open_by_mm=heat.open_by_mm,
        clearance_sigmas=heat.clearance_sigmas,
        spigot_diameter_mm=(shaft.spigot_diameter_mm if shaft else None),
        position_sigma_mm=recipe.limits.position_sigma_mm,
        force_limit_n=recipe.jack_up.force_limit_n,
        theta_low_deg=theta_low_deg,
        theta_high_deg=theta_high_deg,
        contact=ContactModel(chamfer_deg=(holes.chamfer_angle_deg if holes else None) or 45.0),
    )
