"""What each step hands to the next: frozen, journalled before the next step starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cellctl.docking import Alignment
from cellctl.kinematics import AxesPosition
from cellctl.vision.part import PartMeasurement
from hal.interfaces import Band


@dataclass(frozen=True, slots=True)
class Scans:
    """Both parts in the cell frame, and where the axes stood when the shaft was seen."""

    rotor: PartMeasurement
    shaft: PartMeasurement
    shaft_at: AxesPosition
    artefact_residual_mm: float


@dataclass(frozen=True, slots=True)
class Aligned:
    """The shaft stands below the rotor, verified by a scan after the last motion. `expires_at_s` is loop time."""

    alignment: Alignment
    shaft: PartMeasurement
    loops: int
    first: Alignment
    expires_at_s: float


@dataclass(frozen=True, slots=True)
class Insertion:
    """Studs are in up to the spigot. Forces are net (weight tared off), newton, with the recipe's force basis."""

    inserted: bool
    z_mm: float
    weight_n: float
    tare_n: float
    trip_n: float
    peak_total_n: float
    peak_bolt_n: float | None
    force_basis: Literal["per_bolt", "bounded_by_total"]
    tries: int


@dataclass(frozen=True, slots=True)
class HeatSample:
    """One look at the temperatures, degrees Celsius and watt."""

    time_s: float
    spigot_1_c: float
    spigot_2_c: float
    pyrometer_c: float
    rotor_c: float
    power_w: float


@dataclass(frozen=True, slots=True)
class HeatProof:
    """The spigot is warm, proven by channels that agree over the soak. `difference_k` is against the rotor."""

    reached_c: float
    difference_k: float
    spread_k: float
    soak_s: float
    window_low_k: float
    window_high_k: float
    samples: tuple[HeatSample, ...]


@dataclass(frozen=True, slots=True)
class Seating:
    """The faces are together and held by `hold_n` of the jack. `entry_peak_n` is the largest net force before the
    spigot engaged, `peak_n` the largest after that."""

    seated: bool
    z_mm: float
    gap_mm: tuple[float, float, float]
    hold_n: float
    peak_n: float
    seconds_s: float
    entry_peak_n: float = 0.0


@dataclass(frozen=True, slots=True)
class JointResult:
    """One joint in one stage. `verdict` is `unknown` where no result could be had: never taken for tight.

    `torque_nm` is what the gun says, `trace_peak_nm` the largest torque in its trace.
    """

    index: int
    gun: Literal["a", "b"]
    stage: str
    torque_nm: float
    angle_deg: float
    target_torque_nm: float
    torque_low_nm: float
    torque_high_nm: float
    torque_band: Band
    angle_band: Band
    trace_peak_nm: float
    verdict: Literal["ok", "nok", "unknown"]
    tightening_id: int
    trace: str
    engage_tries: int


@dataclass(frozen=True, slots=True)
class Tightened:
    """All results of all stages, in the order in which they were made."""

    joints: tuple[JointResult, ...]
    drift_deg: float
    difference_at_final_k: float


@dataclass(frozen=True, slots=True)
class Closure:
    """The finished joint as the probes and the jack see it."""

    gap_mm: tuple[float, float, float]
    z_mm: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """The run's verdict, recomputable from the record alone."""

    verdict: Literal["accepted", "rejected", "held"]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RunResult:
    """Everything that a whole run found out."""

    scans: Scans
    aligned: Aligned
    insertion: Insertion
    heat: HeatProof | None
    seating: Seating
    tightened: Tightened
    closure: Closure
    verdict: Verdict
