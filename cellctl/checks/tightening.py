"""Can the nuts be tightened as the recipe says? Stages, pairs, stud length, preload."""

from __future__ import annotations

import itertools
import math

from cellctl.checks.finding import Finding
from cellctl.recipe import Recipe

NUT_HEIGHT = 1.2
"""Height of a prevailing-torque nut in stud diameters (ISO 7040: 9.5 mm for M8)."""
WASHER = 0.2
"""Thickness of a plain washer in stud diameters (ISO 7089: 1.6 mm for M8)."""
PROTRUSION_PITCHES = 2.0
"""Full thread beyond the nut."""
FEWEST_STAGES = 3
PAIR_DEG = 0.5
"""How far from opposite a joint may stand so that both guns still find theirs."""


def stage_findings(recipe: Recipe) -> list[Finding]:
    """At least three stages of rising torque, the final one cold, in windows that a gun can meet."""
    stages = recipe.tighten.stages
    place = "tighten.stages"
    if len(stages) < FEWEST_STAGES:
        return [Finding("stages", place, f"{len(stages)} stages are too few", f">= {FEWEST_STAGES}")]
    found = [
        Finding("stages", f"{place}.{number}.torque_nm", "not above the stage before", f"> {before.torque_nm}", "N.m")
        for number, (before, stage) in enumerate(itertools.pairwise(stages), 1)
        if stage.torque_nm <= before.torque_nm
    ]
    if len({stage.name for stage in stages}) < len(stages):
        found.append(Finding("stages", place, "two stages have one name"))
    if not stages[-1].cold:
        found.append(Finding("stages", f"{place}.{len(stages) - 1}.cold", "the final stage is not cold", "true"))
    first = stages[0].torque_nm * (1.0 - stages[0].torque_tolerance)
    for name in ("thread_start_torque_nm", "snug_threshold_nm"):
        value = getattr(recipe.tighten, name)
        if value >= first:
            text = f"{value} N m is reached before the first stage ends"
            found.append(Finding("stages", f"tighten.{name}", text, f"< {first:g}", "N.m"))
    return found


def pair_findings(recipe: Recipe) -> list[Finding]:
    """Two guns 180 degrees apart need an opposite joint for each joint."""
    lone = lone_joints(recipe.pattern.angles())
    if not lone:
        return []
    named = ", ".join(str(index) for index in lone[:6]) + (" ..." if len(lone) > 6 else "")
    text = f"joints {named} have no opposite joint for the second gun"
    return [Finding("opposite_pairs", "pattern.angles_deg", text, f"180 +- {PAIR_DEG}", "deg")]


def lone_joints(angles_deg: tuple[float, ...]) -> tuple[int, ...]:
    """Joints without another one opposite, within PAIR_DEG."""

    def apart(one: float, other: float) -> float:
        return abs((one - other) % 360.0 - 180.0)

    return tuple(
        index for index, angle in enumerate(angles_deg) if min(apart(angle, other) for other in angles_deg) > PAIR_DEG
    )


def stud_findings(recipe: Recipe) -> list[Finding]:
    """The studs must reach through flange, washer and nut."""
    if recipe.shaft is None or recipe.rotor is None:
        return []
    length, depth, thread = recipe.rotor.length_mm, recipe.shaft.depth_mm, recipe.rotor.thread
    if length is None or depth is None or thread is None:
        return []
    needed = depth + (NUT_HEIGHT + WASHER) * thread.major_diameter_mm + PROTRUSION_PITCHES * thread.pitch_mm
    if length >= needed:
        return []
    text = f"{length} mm do not reach through flange, washer and nut"
    return [Finding("stud_length", "rotor.length_mm", text, f">= {needed:.1f}", "mm")]


def preload_findings(recipe: Recipe) -> list[Finding]:
    """The final torque must give a preload within the limits at the friction that is expected."""
    preload = expected_preload_n(recipe)
    limits = recipe.limits
    if preload is None or limits.preload_low_n <= preload <= limits.preload_high_n:
        return []
    text = f"{recipe.tighten.stages[-1].torque_nm} N m give about {preload:.0f} N"
    limit = f"{limits.preload_low_n:.0f} to {limits.preload_high_n:.0f}"
    return [Finding("preload", f"tighten.stages.{len(recipe.tighten.stages) - 1}.torque_nm", text, limit, "N")]


def expected_preload_n(recipe: Recipe) -> float | None:
    """Preload of the final torque; None where thread or stages are missing.

    VDI 2230-1: M = F (P / 2 pi + mu d2 / (2 cos 30) + mu D / 2), lead P = starts x pitch, d2 = d - 0.6495 pitch,
    bearing faces from 1.05 d to 1.5 d + 1 mm. The torque that a self-locking nut takes by itself is not deducted.
    """
    thread = recipe.rotor.thread if recipe.rotor else None
    if thread is None or not recipe.tighten.stages:
        return None
    d, friction = thread.major_diameter_mm, recipe.tighten.friction
    bearing = 0.5 * (1.05 * d + 1.5 * d + 1.0)
    lever_mm = (
        thread.starts * thread.pitch_mm / (2.0 * math.pi)
        + friction * (d - 0.6495 * thread.pitch_mm) / (2.0 * math.cos(math.pi / 6.0))
        + friction * 0.5 * bearing
    )
    return 1e3 * recipe.tighten.stages[-1].torque_nm / lever_mm
