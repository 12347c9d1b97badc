"""The contact force over the jack's height: solved once for one `Dock`, then looked up. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.contact.contact import Contacts, EntryProfile, allowance, axial_ratio, solve
from hal.fake.contact.insertion import Dock, Meeting, bending_n_per_mm, meeting
from hal.fake.contact.press import press_slope_n_per_mm

Array = NDArray[np.float64]

ENTRY_STEP_MM = 0.01
EDGE_MM = 1.001 * ENTRY_STEP_MM
DEEP_STEP_MM = 1.0
SPIGOT_STEP_MM = 0.05
LEAP_MM = 1e-7
"""Of the motor, at least, between two points of a curve: its heights ascend."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceCurve:
    """Forces at ascending motor heights `z_mm` (m,); newton, compression of the jack's sensor positive.

    `stud_in_n` (m, n) and `stud_lateral_n` (m, n) are per stud on the way in. Beyond the last height the shaft stands
    (jammed or seated) and the column yields with `stall_n_per_mm`, of which stud i carries `stall_share[i]`.
    """

    z_mm: Array
    gap_mm: Array
    in_n: Array
    out_n: Array
    stud_in_n: Array
    stud_lateral_n: Array
    float_mm: Array
    stall_n_per_mm: float
    stall_share: Array
    jammed: NDArray[np.bool_]
    touches: bool
    """Whether any stud touches anything."""

    @property
    def stalled(self) -> bool:
        """Whether studs stand on the face and keep the shaft down."""
        return self.gap_mm[-1] > 0.0 and bool(self.jammed.any())

    def force_n(self, z_mm: Array, *, inwards: bool) -> Array:
        """Total contact force at motor heights `z_mm` (k,)."""
        force = np.interp(z_mm, self.z_mm, self.in_n if inwards else self.out_n)
        return np.asarray(force + self.stall_n_per_mm * np.maximum(z_mm - self.z_mm[-1], 0.0))

    def gap_at(self, z_mm: float) -> float:
        """True mean gap of the faces with the motor at `z_mm`."""
        if z_mm < self.z_mm[0]:
            return float(self.gap_mm[0] + self.z_mm[0] - z_mm)
        return float(np.interp(z_mm, self.z_mm, self.gap_mm))

    def stiffness_n_per_mm(self, z_mm: float) -> float:
        """How fast the total force grows with the height at `z_mm`, never negative."""
        near = self.force_n(np.array([z_mm - 0.5 * ENTRY_STEP_MM, z_mm + 0.5 * ENTRY_STEP_MM]), inwards=True)
        return max(float(near[1] - near[0]) / ENTRY_STEP_MM, 0.0)

    def stud_peaks_n(self, low_mm: float, high_mm: float, *, above_gap_mm: float = 0.0) -> tuple[Array, Array]:
        """(n,) largest axial and lateral force of each stud while the motor is in [low, high] and the gap is larger
        than `above_gap_mm`."""
        inside = (self.z_mm > low_mm) & (self.z_mm < high_mm) & (self.gap_mm > above_gap_mm)
        ends = [self._studs_at(z) for z in (low_mm, high_mm) if self.gap_at(z) > above_gap_mm]
        axial = [self.stud_in_n[inside], *(end[0][None] for end in ends)]
        lateral = [self.stud_lateral_n[inside], *(end[1][None] for end in ends)]
        none = np.zeros((1, self.stud_in_n.shape[1]))
        return np.max(np.vstack([none, *axial]), axis=0), np.max(np.vstack([none, *lateral]), axis=0)

    def _studs_at(self, z_mm: float) -> tuple[Array, Array]:
        after = int(np.clip(np.searchsorted(self.z_mm, z_mm), 1, len(self.z_mm) - 1)) if len(self.z_mm) > 1 else 0
        before = max(after - 1, 0)
        width = self.z_mm[after] - self.z_mm[before]
        share = 0.0 if width <= 0.0 else float(np.clip((z_mm - self.z_mm[before]) / width, 0.0, 1.0))
        stall = self.stall_n_per_mm * max(z_mm - float(self.z_mm[-1]), 0.0) * self.stall_share
        if z_mm < self.z_mm[0]:
            return np.zeros_like(stall), np.zeros_like(stall)
        axial = (1.0 - share) * self.stud_in_n[before] + share * self.stud_in_n[after] + stall
        lateral = (1.0 - share) * self.stud_lateral_n[before] + share * self.stud_lateral_n[after]
        return axial, lateral


def gap_grid(dock: Dock) -> Array:
    """Descending gaps: fine where cones meet, coarse while cylinders slide, fine again over the spigot."""
    geometry = dock.geometry
    entry = geometry.stud_length_mm
    cones = geometry.lead_in_mm + geometry.chamfer_depth_mm + 1.0
    spigot = geometry.spigot_length_mm + SPIGOT_STEP_MM
    return np.concatenate(
        [
            np.arange(entry + 0.5, entry - cones, -ENTRY_STEP_MM),
            np.arange(entry - cones, spigot, -DEEP_STEP_MM),
            np.arange(spigot, 0.0, -SPIGOT_STEP_MM),
            [0.0],
        ]
    )


def force_curve(dock: Dock, gaps_mm: Array | None = None) -> ForceCurve:
    """Solve the contact at descending true gaps `gaps_mm` (default: the whole insertion)."""
    gaps = gap_grid(dock) if gaps_mm is None else np.asarray(gaps_mm, dtype=np.float64)
    heights = dock.heights_mm(gaps)
    met = meeting(dock, heights)
    profile = dock.profile(met.holes)
    jammed = jams(dock, met, profile)
    length = dock.geometry.stud_length_mm
    if jammed.any():
        # The highest place that the shaft reaches is where the first blocked stud's end meets the face.
        room = (met.gap_mm - length)[:, jammed].min(axis=1)
        stop = float(np.interp(0.0, room[::-1], heights[::-1]))
        keep = heights < stop
        heights = np.append(heights[keep], stop)
        gaps = np.append(gaps[keep], gaps[0] + heights[0] - stop if len(heights) > 1 else gaps[0])
        met = meeting(dock, heights)
    return _curve(dock, heights, gaps, met, profile, jammed)


def jams(dock: Dock, met: Meeting, profile: EntryProfile) -> NDArray[np.bool_]:
    """(n,) studs whose end would meet the face outside the chamfer, or a cone beyond the wedging limit.

    None where the heights begin with the studs inside: what is in the hole bends, it does not jump out.
    """
    if float(met.gap_mm[0].max()) < dock.geometry.stud_length_mm:
        return np.zeros(dock.geometry.count, dtype=bool)
    depth = dock.geometry.stud_length_mm - met.gap_mm
    entry = np.argmin(np.abs(depth), axis=0)
    touch = np.take_along_axis(met.offset_mm(np.zeros_like(depth)), entry[None, :, None], axis=0)[0]
    reached = depth.max(axis=0) > -1.0
    beyond = np.linalg.norm(touch, axis=1) > profile.chamfer_mm - profile.tip_mm
    steepest = max(profile.tan_chamfer, profile.tan_lead_in)
    locked = bool(np.isinf(axial_ratio(steepest, dock.properties.friction_coefficient)))
    wedged = locked & (np.linalg.norm(touch, axis=1) > profile.hole_mm - profile.stud_mm)
    return np.asarray(reached & (beyond | wedged))


def _curve(
    dock: Dock, heights: Array, gaps: Array, met: Meeting, profile: EntryProfile, jammed: NDArray[np.bool_]
) -> ForceCurve:
    n, mu = dock.geometry.count, dock.properties.friction_coefficient
    contacts = _contacts(dock, met, profile, gaps, jammed)
    floated = solve(contacts, dock.stiffness_n_per_mm(), 0.5 * dock.geometry.circle_diameter_mm)
    lateral = floated.lateral_n
    onto = np.zeros((lateral.shape[1], n + 1))
    onto[np.arange(lateral.shape[1]), contacts.stud] = 1.0
    into = np.where(lateral > 0.0, axial_ratio(contacts.tan_phi, mu), 0.0) * lateral @ onto
    back = np.where(lateral > 0.0, axial_ratio(contacts.tan_phi, mu, inwards=False), 0.0) * lateral @ onto
    engaged = np.maximum(dock.geometry.spigot_length_mm - dock.geometry.spigot_chamfer_mm - gaps, 0.0)
    press = engaged * press_slope_n_per_mm(
        dock.geometry, dock.interference_mm, dock.properties.stud_modulus_n_per_mm2, mu
    )
    faces = dock.faces().force_n(gaps)
    column = press + faces + into.sum(axis=1) - dock.clamp_force_n
    stiffness = dock.properties.axial_stiffness_n_per_mm
    # Whatever resists is met through the column; where it gives way faster than the column springs back, the shaft
    # leaps: the motor is where it was.
    leap = LEAP_MM * np.arange(len(heights))
    motor = dock.motor_mm(np.maximum.accumulate(heights + column / stiffness - leap) + leap)
    share = jammed / max(int(jammed.sum()), 1)
    return ForceCurve(
        z_mm=motor,
        gap_mm=gaps,
        in_n=column,
        out_n=back.sum(axis=1) - press + faces - dock.clamp_force_n,
        stud_in_n=into[:, :n],
        stud_lateral_n=lateral @ onto[:, :n],
        float_mm=floated.float_mm,
        stall_n_per_mm=stiffness,
        stall_share=share.astype(np.float64),
        jammed=jammed,
        touches=bool(jammed.any() or lateral[:, :-1].any()),
    )


def _contacts(dock: Dock, met: Meeting, profile: EntryProfile, gaps: Array, jammed: NDArray[np.bool_]) -> Contacts:
    """Mouth and tip of each stud, and the spigot as one more contact about the centre."""
    geometry, properties, n = dock.geometry, dock.properties, dock.geometry.count
    depth = geometry.stud_length_mm - met.gap_mm
    mouth = np.clip(depth, 0.0, profile.chamfer_depth_mm)
    free, slope = allowance(profile, depth, edge_mm=EDGE_MM)
    tip = np.clip(depth - profile.lead_in_mm, profile.chamfer_depth_mm, geometry.hole_depth_mm)
    inside = depth > profile.full_depth_mm
    tip_free = np.where(inside, profile.hole_mm - profile.stud_mm, np.inf)
    spigot = geometry.spigot_length_mm - gaps
    opening = max(-0.5 * dock.interference_mm, 0.0)
    spigot_free = np.where(spigot > 0.0, opening + np.maximum(geometry.spigot_chamfer_mm - spigot, 0.0), np.inf)
    spigot_slope = np.where((spigot > 0.0) & (spigot < geometry.spigot_chamfer_mm), 1.0, 0.0)
    centre = dock.rotor.T_cell_rotor[:2, 3] - met.centre_mm
    arm = met.hole_mm - met.centre_mm[:, None, :]
    blocked = np.where(jammed, np.inf, 0.0)
    return Contacts(
        offset_mm=np.concatenate([met.offset_mm(mouth), met.offset_mm(tip), centre[:, None, :]], axis=1),
        arm_mm=np.concatenate([arm, arm, np.zeros((len(gaps), 1, 2))], axis=1),
        free_mm=np.concatenate([free + blocked, tip_free + blocked, spigot_free[:, None]], axis=1),
        tan_phi=np.concatenate([slope, np.zeros_like(slope), spigot_slope[:, None]], axis=1),
        stiffness_n_per_mm=np.concatenate(
            [
                bending_n_per_mm(geometry, properties, met.gap_mm + mouth),
                bending_n_per_mm(geometry, properties, met.gap_mm + tip),
                np.full((len(gaps), 1), properties.spigot_stiffness_n_per_mm),
            ],
            axis=1,
        ),
        stud=np.concatenate([np.arange(n), np.arange(n), [n]]),
    )
