"""The one door by which the plant's truth leaves: what its owner writes down after the run has ended."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from hal.fake.contact.curve import force_curve
from hal.fake.contact.engagement import present_error
from hal.fake.plant import Plant

RIM_PLACES = 24


@dataclass(frozen=True, slots=True)
class TruthLimits:
    """What makes a joint good; the defaults are those of the 36-stud joint."""

    force_per_bolt_n: float = 10.0
    gap_mm: float = 0.05
    preload_low_n: float = 10_000.0
    preload_high_n: float = 32_000.0


@dataclass(frozen=True, slots=True)
class Truth:
    """How the assembly really ended. Errors are the shaft's pose minus its best pose when the studs entered."""

    good: bool
    reasons: tuple[str, ...]
    theta_error_deg: float
    x_error_mm: float
    y_error_mm: float
    inserted: bool
    peak_force_per_bolt_n: tuple[float, ...]
    seating_gap_mm: float
    preload_n: tuple[float, ...]
    overrides: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return asdict(self) | {name: list(getattr(self, name)) for name in ("reasons", *_PER_BOLT)}


_PER_BOLT = ("peak_force_per_bolt_n", "preload_n")


def truth_of(plant: Plant, limits: TruthLimits | None = None) -> Truth:
    """The truth at the plant's last advance."""
    limits = limits or TruthLimits()
    error = plant.engagement.entry_error or present_error(plant.dock())
    inserted, gap = studs_in(plant), rim_gap_mm(plant)
    peaks, preload = plant.engagement.peak_n, np.asarray(plant.joints.preload_n(), dtype=np.float64)
    reasons = [*_reasons(plant, limits, inserted=inserted, gap_mm=gap), *plant.damages]
    return Truth(
        good=not reasons,
        reasons=tuple(reasons),
        theta_error_deg=error.theta_deg,
        x_error_mm=error.x_mm,
        y_error_mm=error.y_mm,
        inserted=inserted,
        peak_force_per_bolt_n=tuple(float(peak) for peak in peaks),
        seating_gap_mm=gap,
        preload_n=tuple(float(force) for force in preload),
        overrides=dict(plant.numbers.overrides),
    )


def studs_in(plant: Plant) -> bool:
    """Whether every stud is in a hole beyond its chamfer."""
    geometry = plant.geometry
    entered = geometry.entry_gap_mm - geometry.lead_in_mm - geometry.chamfer_depth_mm
    if plant.gap_mm() > entered:
        return False
    return not force_curve(plant.dock()).jammed.any()


def rim_gap_mm(plant: Plant) -> float:
    """Largest distance of the faces along their outer rim."""
    radius = 0.5 * plant.geometry.face_outer_diameter_mm
    places = (2.0 * math.pi * k / RIM_PLACES for k in range(RIM_PLACES))
    return max(plant.gap_at(radius * math.cos(angle), radius * math.sin(angle)) for angle in places)


def _reasons(plant: Plant, limits: TruthLimits, *, inserted: bool, gap_mm: float) -> list[str]:
    reasons = []
    if not inserted:
        reasons.append("not all studs are inserted")
    worst = int(np.argmax(plant.engagement.peak_n))
    if (peak := float(plant.engagement.peak_n[worst])) > limits.force_per_bolt_n:
        reasons.append(f"stud {worst} met {peak:.1f} N before seating (limit {limits.force_per_bolt_n:g} N)")
    if gap_mm > limits.gap_mm:
        reasons.append(f"the faces are {gap_mm:.3f} mm apart (limit {limits.gap_mm:g} mm)")
    preload = plant.joints.preload_n()
    outside = np.flatnonzero((preload < limits.preload_low_n) | (preload > limits.preload_high_n))
    if outside.size:
        listed = ", ".join(str(stud) for stud in outside)
        reasons.append(
            f"preload outside {limits.preload_low_n:g} to {limits.preload_high_n:g} N at {outside.size} studs: {listed}"
        )
    yielded = np.flatnonzero(plant.joints.yielded())
    if yielded.size:
        reasons.append(f"yielded or stripped: {', '.join(str(stud) for stud in yielded)}")
    return reasons
