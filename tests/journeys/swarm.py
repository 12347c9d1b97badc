"""Random faults for whole runs, and what must hold after each of them whatever was planted."""

from __future__ import annotations

from random import Random

from cellctl.runner import Outcome
from hal.fake.fault_file import Fault
from hal.fake.fault_kinds import DEVICE_KINDS, PHASES

LENGTH_S = {"scan": 60.0, "align": 4.0, "jack_up": 200.0, "heat": 320.0, "tighten": 340.0}
"""About how long the phases of the small joint last."""
VALUES: dict[str, tuple[float, ...]] = {
    "s": (0.02, 0.2, 1.0, 3.0),
    "reading": (-50.0, 0.0, 5.0, 30.0, 250.0),
    "reading/s": (-1.0, -0.1, 0.02, 0.2, 5.0),
    "1": (-3.0, 0.5, 0.8, 1.2),
    "bar": (0.0, 3.0, 5.0),
}


WRONG: dict[str, tuple[float, float]] = {
    "fit_interference_mm": (0.0, 0.11),
    "shaft_mass_kg": (94.0, 106.0),
    "hole_diameter_mm": (8.1, 8.3),
    "stud_diameter_mm": (7.95, 8.15),
    "circle_diameter_shift_mm": (-0.3, 0.3),
    "hole_0_shift_x_mm": (-0.25, 0.25),
    "hole_0_shift_y_mm": (-0.25, 0.25),
    "jack_line_tilt_x_deg": (-0.04, 0.04),
    "jack_line_tilt_y_deg": (-0.04, 0.04),
    "table_axis_shift_x_mm": (-1.0, 1.0),
    "table_axis_tilt_y_deg": (-0.1, 0.1),
    "shaft_tilt_x_deg": (-0.12, 0.12),
    "camera_rotor_shift_x_mm": (-0.12, 0.12),
    "camera_shaft_shift_y_mm": (-0.12, 0.12),
    "camera_shaft_rotation_deg": (-0.03, 0.03),
    "force_gain": (0.9, 1.1),
    "force_delay_s": (0.0, 0.02),
    "lateral_stiffness_n_per_mm": (200.0, 10_000.0),
    "friction_coefficient": (0.05, 0.35),
    "brake_late_s": (0.0, 0.2),
    "friction_per_nut": (0.0, 0.4),
    "friction_per_pass": (0.0, 0.25),
    "ambient_c": (5.0, 35.0),
    "feature_position_mm": (0.0, 0.05),
    "feature_tilt_deg": (0.0, 0.2),
}
"""Numbers of the twin and how far the truth is moved: up to where some gate must notice, often just short of it."""


def wrong_truth(draw: Random) -> dict[str, float]:
    """Up to three of the twin's numbers, away from what the controller believes."""
    names = draw.sample(sorted(WRONG), draw.choice((1, 1, 2, 3)))
    return {name: round(draw.uniform(*WRONG[name]), 4) for name in names}


def random_faults(draw: Random, joints: int) -> tuple[Fault, ...]:
    """One fault, sometimes two, of any kind at any device in any phase; half of them pass again."""
    return tuple(random_fault(draw, joints) for _ in range(1 if draw.random() < 0.8 else 2))


def random_fault(draw: Random, joints: int, device: str = "", kind: str = "") -> Fault:
    """A fault of that kind at that device, or of any."""
    device = device or draw.choice(sorted(DEVICE_KINDS))
    kind = kind or draw.choice(sorted(DEVICE_KINDS[device]))
    need = DEVICE_KINDS[device][kind]
    value: float | None = None
    if need.unit == "joint":
        value = float(draw.randrange(joints))
    elif need.value == "needed" or (need.value == "optional" and draw.random() < 0.5):
        value = draw.choice(VALUES[need.unit])
    phase = draw.choice(PHASES)
    at_s = 0.0 if need.unit == "joint" else round(draw.uniform(0.0, LENGTH_S[phase]), 3)
    lasting = draw.random() < 0.5
    return Fault(device, kind, phase, at_s, value, *(() if lasting else (round(draw.uniform(0.05, 30.0), 3),)))


def broken(outcome: Outcome) -> list[str]:
    """What a run must never do, as far as this one did it."""
    found = []
    if outcome.verdict == "accepted" and not outcome.truth.good:
        found.append(f"accepted, but in truth {'; '.join(outcome.truth.reasons)}")
    if (outcome.state == "Complete") == (outcome.verdict == "held"):
        found.append(f"{outcome.state} with verdict {outcome.verdict}")
    if outcome.verdict != "accepted" and not outcome.reasons:
        found.append("no reason is given")
    if any("internal_error" in reason or "Error:" in reason for reason in outcome.reasons):
        found.append(f"an error that nobody foresaw: {'; '.join(outcome.reasons)}")
    return found
