"""Do the two parts exist as drawn, and do they fit into each other? Millimetres and degrees."""

from __future__ import annotations

import math

from cellctl.checks.finding import Finding
from cellctl.recipe import PartSpec, Pattern, Recipe

THREAD_BAND = 0.3
"""Crest of an external thread below its nominal diameter, in pitches, at most (ISO 965-1, class 6g, with room)."""


def parts_findings(recipe: Recipe) -> list[Finding]:
    """Each part by itself: pattern, face, chamfer, thread."""
    found = []
    for side, spec in (("shaft", recipe.shaft), ("rotor", recipe.rotor)):
        if spec is not None:
            found += _on_face(recipe, side, spec)
            found += _sizes(side, spec)
    return found


def fit_findings(recipe: Recipe) -> list[Finding]:
    """Both parts against each other; nothing where one of them is not given."""
    shaft, rotor = recipe.shaft, recipe.rotor
    if shaft is None or rotor is None:
        return []
    if (shaft.feature, rotor.feature) != ("hole", "stud"):
        return [Finding("features", "rotor.feature", "the rotor's studs enter the shaft's holes", "stud, hole")]
    found = []
    for place, spec, needed in (
        ("shaft", shaft, ("diameter_mm", "depth_mm", "spigot_diameter_mm")),
        ("rotor", rotor, ("diameter_mm", "length_mm", "spigot_diameter_mm", "thread")),
    ):
        found += [
            Finding("sizes_missing", f"{place}.{name}", "an assembly needs this size")
            for name in needed
            if getattr(spec, name) is None
        ]
    if shaft.spigot_diameter_mm != rotor.spigot_diameter_mm:
        text = f"{rotor.spigot_diameter_mm} mm is not the shaft's nominal diameter"
        found.append(Finding("spigot_fit", "rotor.spigot_diameter_mm", text, str(shaft.spigot_diameter_mm), "mm"))
    return found + _hole_clearance(recipe, shaft, rotor)


def _hole_clearance(recipe: Recipe, shaft: PartSpec, rotor: PartSpec) -> list[Finding]:
    holes, studs = diameters(shaft), diameters(rotor)
    if not holes or not studs:
        return []
    pairs = zip(_spread(holes, recipe.pattern.count), _spread(studs, recipe.pattern.count), strict=True)
    clearance = min(0.5 * (hole - stud) for hole, stud in pairs)
    if clearance <= 0:
        return [
            Finding(
                "hole_clearance", "shaft.diameter_mm", "a hole is not larger than its stud", f"> {max(studs)}", "mm"
            )
        ]
    claimed = recipe.limits.radial_clearance_mm
    if claimed > clearance + 1e-9:
        text = f"{claimed} mm is more than holes and studs leave"
        return [Finding("hole_clearance", "limits.radial_clearance_mm", text, f"<= {clearance:.4g}", "mm")]
    return []


def _on_face(recipe: Recipe, side: str, spec: PartSpec) -> list[Finding]:
    found = []
    inner, outer = spec.face_inner_diameter_mm, spec.face_outer_diameter_mm
    if inner is not None and outer is not None and inner >= outer:
        text = f"{inner} mm is not below the outer diameter"
        found.append(Finding("face", f"{side}.face_inner_diameter_mm", text, f"< {outer}", "mm"))
    circle = recipe.pattern.circle_diameter_mm
    widest = max([*diameters(spec), spec.chamfer_diameter_mm or 0.0])
    if (inner is not None and circle - widest < inner) or (outer is not None and circle + widest > outer):
        text = f"features of {widest} mm on {circle} mm do not lie on the face"
        found.append(Finding("face", f"{side}.face_outer_diameter_mm", text))
    chord = smallest_chord_mm(recipe.pattern)
    if chord <= widest:
        text = f"neighbours {chord:.2f} mm apart overlap"
        found.append(Finding("pattern_overlap", "pattern.angles_deg", text, f"> {widest}", "mm"))
    return found


def _sizes(side: str, spec: PartSpec) -> list[Finding]:
    found = []
    sizes = diameters(spec)
    if spec.chamfer_diameter_mm is not None and sizes and spec.chamfer_diameter_mm <= max(sizes):
        text = f"{spec.chamfer_diameter_mm} mm is not wider than the feature"
        found.append(Finding("chamfer", f"{side}.chamfer_diameter_mm", text, f"> {max(sizes)}", "mm"))
    thread = spec.thread
    if thread is not None and any(
        abs(size - thread.major_diameter_mm) > THREAD_BAND * thread.pitch_mm for size in sizes
    ):
        text = f"{sizes[0]} mm is not the crest of a thread of {thread.major_diameter_mm} mm"
        found.append(Finding("thread_size", f"{side}.diameter_mm", text, str(thread.major_diameter_mm), "mm"))
    return found


def diameters(spec: PartSpec) -> tuple[float, ...]:
    """The given diameters: none, one for all, or one for each feature."""
    if spec.diameter_mm is None:
        return ()
    return spec.diameter_mm if isinstance(spec.diameter_mm, tuple) else (spec.diameter_mm,)


def smallest_chord_mm(pattern: Pattern) -> float:
    """Smallest distance between the centres of two features."""
    angles = sorted(angle % 360.0 for angle in pattern.angles())
    steps = [after - before for before, after in zip(angles, [*angles[1:], angles[0] + 360.0], strict=True)]
    return pattern.circle_diameter_mm * math.sin(math.radians(0.5 * min(min(steps), 180.0)))


def _spread(sizes: tuple[float, ...], count: int) -> tuple[float, ...]:
    return sizes if len(sizes) == count else sizes[:1] * count
