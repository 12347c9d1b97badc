"""One verdict from gap probes and jack height, forces, temperatures, torques. Pure: recomputable from the record."""

from __future__ import annotations

from collections import Counter

from cellctl.recipe import Recipe
from cellctl.steps.results import Closure, HeatProof, Insertion, JointResult, Seating, Tightened, Verdict


def evaluate(
    recipe: Recipe,
    insertion: Insertion,
    heat: HeatProof | None,
    seating: Seating,
    tightened: Tightened,
    closure: Closure,
) -> Verdict:
    """Accepted when nothing speaks against it; every reason is one sentence with value, limit and unit."""
    reasons = (
        *_insertion(recipe, insertion),
        *_heat(recipe, heat),
        *_closure(recipe, seating, closure),
        *_joints(recipe, tightened.joints),
    )
    return Verdict(verdict="rejected" if reasons else "accepted", reasons=reasons)


def _insertion(recipe: Recipe, insertion: Insertion) -> tuple[str, ...]:
    reasons = []
    if not insertion.inserted:
        reasons.append("not all studs are inserted")
    limit = recipe.jack_up.force_limit_n
    peak = insertion.peak_total_n if insertion.peak_bolt_n is None else insertion.peak_bolt_n
    if not peak < limit:
        reasons.append(f"insertion force {peak:.1f} N reached the limit of {limit} N ({insertion.force_basis})")
    return tuple(reasons)


def _heat(recipe: Recipe, heat: HeatProof | None) -> tuple[str, ...]:
    if heat is None:
        return ("the spigot was not heated",) if recipe.heat.enabled else ()
    if not heat.window_low_k <= heat.difference_k <= heat.window_high_k:
        return (
            f"temperature difference {heat.difference_k:.1f} K outside "
            f"{heat.window_low_k:.1f} to {heat.window_high_k:.1f} K",
        )
    return ()


def _closure(recipe: Recipe, seating: Seating, closure: Closure) -> tuple[str, ...]:
    reasons = []
    limit = recipe.limits.gap_mm
    if not seating.entry_peak_n < recipe.jack_up.force_limit_n:
        reasons.append(f"{seating.entry_peak_n:.1f} N before the spigot (limit {recipe.jack_up.force_limit_n} N)")
    if not seating.seated and not recipe.heat.draw_in:
        reasons.append("the joint was not seated")
    for number, gap in enumerate(closure.gap_mm, start=1):
        if not abs(gap) <= limit:
            reasons.append(f"gap probe {number} reads {gap:.3f} mm (limit {limit} mm)")
    return tuple(reasons)


def _joints(recipe: Recipe, joints: tuple[JointResult, ...]) -> tuple[str, ...]:
    stages = [*(stage.name for stage in recipe.tighten.stages), "verify"]
    seen = Counter((joint.index, joint.stage) for joint in joints)
    reasons = [
        f"joint {joint.index} is {joint.verdict} in stage {joint.stage}" for joint in joints if joint.verdict != "ok"
    ]
    for index in range(recipe.pattern.count):
        for stage in stages:
            times = seen[index, stage]
            if times != 1:
                reasons.append(f"joint {index} has {times} results in stage {stage}, one is due")
    told = Counter((joint.gun, joint.tightening_id) for joint in joints if joint.verdict != "unknown")
    reasons += [f"tightening {number} of gun {gun} counts {n} times" for (gun, number), n in told.items() if n > 1]
    return tuple(reasons)
