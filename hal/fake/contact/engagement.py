"""What the plant remembers of the insertion: the present force curve, peak force of each stud, pose at entry.

Curves are kept until stage, table, temperatures or clamping have changed by more than the contact can feel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.contact.curve import ForceCurve, force_curve, gap_grid
from hal.fake.contact.docking import PoseError, at_best_pose, pose_error
from hal.fake.contact.insertion import Dock
from hal.fake.contact.press import press_slope_n_per_mm
from hal.fake.motion import AxisMotion

Array = NDArray[np.float64]

MOVING_STEP_MM = 0.001
"""Growth of hole circle or fit that calls for a new curve while the jack moves."""
STANDING_STEP_MM = 0.0005
"""Likewise while it stands."""
CLAMPED_STEP_MM = 0.01
"""Likewise while the nuts hold the joint."""
NEAR_MM = 1.0
"""Half the height of a local curve while the jack stands among the studs."""


@dataclass(frozen=True, slots=True)
class Ring:
    """A mass stopped on a contact swings on: displacement ``amplitude exp(-zeta w t) sin(w t)`` from `start_s` on."""

    start_s: float
    amplitude_mm: float
    omega: float
    damping: float

    def at(self, time_s: Array) -> Array:
        """Displacement in mm at times (k,)."""
        t = np.maximum(time_s - self.start_s, 0.0)
        return np.asarray(self.amplitude_mm * np.exp(-self.damping * self.omega * t) * np.sin(self.omega * t))

    @property
    def peak_mm(self) -> float:
        """First maximum, at a quarter period."""
        return self.amplitude_mm * math.exp(-self.damping * 0.5 * math.pi)


def ring_of(
    stiffness_n_per_mm: float,
    mass_kg: float,
    speed_mm_s: float,
    deceleration_mm_s2: float,
    damping: float,
    start_s: float,
) -> Ring | None:
    """The swing after a stop from `speed_mm_s` on a contact: v / w, less where the stop takes a good part of a period.

    An undamped oscillator whose base stops evenly within T keeps v / w |sin(w T / 2) / (w T / 2)|. With T = 0 the
    force goes on to rise by v sqrt(k m).
    """
    if stiffness_n_per_mm <= 0.0 or speed_mm_s <= 0.0:
        return None
    omega = math.sqrt(stiffness_n_per_mm * 1e3 / mass_kg)
    half = 0.5 * omega * speed_mm_s / deceleration_mm_s2
    left = abs(math.sin(half) / half) if half > 0.0 else 1.0
    return Ring(start_s, speed_mm_s / omega * left, omega, damping)


class Engagement:
    """Curve cache and bookkeeping of one pair of parts. The plant asks; nothing here knows the time."""

    def __init__(self, count: int) -> None:
        self.peak_n = np.zeros(count)
        """Largest axial force of each stud before the spigot engaged."""
        self.lateral_peak_n = np.zeros(count)
        self.peak_total_n = 0.0
        self.entry_error: PoseError | None = None
        self.ring: Ring | None = None
        self._key: tuple[object, ...] = ()
        self._curve: ForceCurve | None = None
        self._local_key: tuple[object, ...] = ()
        self._local: ForceCurve | None = None
        self._recorded: tuple[ForceCurve, float, float] | None = None

    def curve(self, dock: Dock, low_mm: float) -> ForceCurve:
        """A curve of `dock` that holds from motor height `low_mm` on: without the entry where the studs are in."""
        inside = _studs_in(dock, self._gap(dock, low_mm)) and not self._jammed()
        key = (inside, *_key(dock, MOVING_STEP_MM))
        if self._curve is None or key != self._key:
            self._key, self._curve = key, force_curve(dock, _inner_grid(dock) if inside else None)
        return self._curve

    def near(self, dock: Dock, z_mm: float) -> ForceCurve:
        """A curve that holds at motor height `z_mm`: a small one where the studs are in and the jack stands there."""
        gap = self._gap(dock, z_mm)
        inside = _studs_in(dock, gap) and not self._jammed()
        if self._curve is not None and (inside, *_key(dock, MOVING_STEP_MM)) == self._key:
            return self._curve
        if not inside or dock.clamp_force_n > 0.0 or gap <= dock.geometry.spigot_length_mm + NEAR_MM:
            return self.curve(dock, z_mm)
        key = (round(z_mm, 3), *_key(dock, STANDING_STEP_MM))
        if self._local is None or key != self._local_key:
            around = np.array([gap + 0.9 * NEAR_MM, gap, gap - 0.9 * NEAR_MM])
            self._local_key, self._local = key, force_curve(dock, around)
        return self._local

    def _jammed(self) -> bool:
        return self._curve is not None and self._curve.stalled

    @staticmethod
    def _gap(dock: Dock, z_mm: float) -> float:
        """Gap where nothing touched, within the micrometres of jack and chuck."""
        return dock.bench.rotor_face_mm - z_mm

    def record(self, curve: ForceCurve, low_mm: float, high_mm: float, seat_gap_mm: float) -> bool:
        """The jack's motor was in [low, high] under `curve`; where the gap is below `seat_gap_mm` the joint is being
        seated. Returns whether a stud can have been touched."""
        seen = (curve, low_mm, high_mm)
        if not curve.touches or seen == self._recorded:
            return False
        self._recorded = seen
        axial, lateral = curve.stud_peaks_n(low_mm, high_mm, above_gap_mm=seat_gap_mm)
        self.peak_n = np.maximum(self.peak_n, axial)
        self.lateral_peak_n = np.maximum(self.lateral_peak_n, lateral)
        inside = np.unique(np.clip(curve.z_mm[curve.gap_mm > seat_gap_mm], low_mm, high_mm))
        if inside.size:
            self.peak_total_n = max(self.peak_total_n, float(curve.force_n(inside, inwards=True).max()))
        return True

    def enter(self, dock: Dock) -> None:
        """The studs have just passed the chamfers: remember how well the shaft stood."""
        self.entry_error = pose_error(dock)

    def stopped(
        self, curve: ForceCurve, jack: AxisMotion, dock: Dock, speed: float, deceleration: float, now: float
    ) -> None:
        """A quick stop from `speed` (mm/s, upwards positive): the mass swings on, which the studs feel."""
        z = jack.position(now)
        stiffness = curve.stiffness_n_per_mm(z)
        damping = dock.properties.contact_damping
        self.ring = ring_of(stiffness, dock.shaft.mass_kg, speed, deceleration, damping, jack.now_at.end_s)
        if self.ring is not None:
            end = jack.now_at.target
            self.record(curve, end, end + self.ring.peak_mm, dock.geometry.spigot_length_mm)


def present_error(dock: Dock) -> PoseError:
    """How far the shaft is from its best pose, by the pattern's own nearest angle."""
    best = at_best_pose(dock)
    return PoseError(-best.offset_mm[0], -best.offset_mm[1], -best.offset_deg)


def closing_resistance_n(dock: Dock) -> float:
    """Axial force that closes the joint against press fit and the faces' tilt, newton."""
    geometry, properties = dock.geometry, dock.properties
    engaged = geometry.spigot_length_mm - geometry.spigot_chamfer_mm
    press = engaged * press_slope_n_per_mm(
        geometry, dock.interference_mm, properties.stud_modulus_n_per_mm2, properties.friction_coefficient
    )
    return press + float(dock.faces().force_n(np.zeros(1))[0])


def _studs_in(dock: Dock, gap_mm: float) -> bool:
    return gap_mm < _deepest_entry_mm(dock)


def _deepest_entry_mm(dock: Dock) -> float:
    """Gap below which the studs are through the chamfers, with room for a local curve."""
    geometry = dock.geometry
    return geometry.entry_gap_mm - geometry.lead_in_mm - geometry.chamfer_depth_mm - 2.0 * NEAR_MM


def _inner_grid(dock: Dock) -> Array:
    """The part of the grid beyond the entry, from well before the studs count as in."""
    gaps = gap_grid(dock)
    return np.asarray(gaps[_deepest_entry_mm(dock) > gaps - NEAR_MM])


def _key(dock: Dock, step_mm: float) -> tuple[object, ...]:
    radius = 0.5 * dock.geometry.circle_diameter_mm
    at = dock.motors
    if dock.clamp_force_n > 0.0:
        step_mm = CLAMPED_STEP_MM
    return (
        id(dock.rotor),
        id(dock.shaft),
        (at.x_mm, at.y_mm, at.theta_deg, at.directions),
        dock.slip_deg,
        dock.clamped,
        round(dock.clamp_force_n, -2),
        round(dock.interference_mm / step_mm),
        round(dock.circle_growth * radius / step_mm),
    )
