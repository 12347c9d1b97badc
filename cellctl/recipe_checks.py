"""Physics checks of a recipe: alone, against the cell, against the calibration. Pure; every check has a stable name.

A run is refused with any finding whose name was not forced (``cellctl run --force NAME``); the names stand in
`CHECK_NAMES`. A recipe that only measures (one part) has its geometry checked and nothing else.
"""

from __future__ import annotations

from cellctl.calibration import Calibration
from cellctl.checks.cell import calibration_findings, cell_findings
from cellctl.checks.docking import contact_speed_findings, gate_findings, insertion_trip_n
from cellctl.checks.finding import Finding
from cellctl.checks.heating import fit_heat_findings, heater_findings, heating_findings
from cellctl.checks.parts import fit_findings, parts_findings
from cellctl.checks.tightening import pair_findings, preload_findings, stage_findings, stud_findings
from cellctl.recipe import Recipe
from hal.config import CellConfig

__all__ = ["CHECK_NAMES", "Finding", "check", "insertion_trip_n"]

CHECK_NAMES = (
    "align_gate", "cell_limits", "chamfer", "cold_interference", "contact_speed", "face", "features", "heat_timeout",
    "heated_member", "heater_power", "hole_clearance", "limit_order", "opposite_pairs", "parts", "pattern_overlap",
    "preload", "scan_distance", "seat_window", "sizes_missing", "spigot_fit", "stages", "stud_length",
    "temperature_limit", "temperature_window", "thread_size", "views",
)  # fmt: skip


def check(
    recipe: Recipe, cell: CellConfig | None = None, calibration: Calibration | None = None
) -> tuple[Finding, ...]:
    """Every finding, in a fixed order. With a cell the recipe is meant to run there, so both parts are needed."""
    assembly = recipe.shaft is not None and recipe.rotor is not None
    findings = [*parts_findings(recipe), *limit_findings(recipe)]
    if assembly:
        findings += fit_findings(recipe)
        findings += gate_findings(recipe)
        findings += contact_speed_findings(recipe, cell)
        findings += fit_heat_findings(recipe)
        findings += heating_findings(recipe)
        findings += stage_findings(recipe)
        findings += pair_findings(recipe)
        findings += stud_findings(recipe)
        findings += preload_findings(recipe)
    if cell is not None:
        if not assembly:
            missing = "shaft" if recipe.shaft is None else "rotor"
            findings.append(Finding("parts", missing, "an assembly needs both parts"))
        findings += cell_findings(recipe, cell)
        findings += heater_findings(recipe, cell)
        findings += calibration_findings(recipe, cell, calibration) if calibration is not None else []
    return tuple(findings)


def limit_findings(recipe: Recipe) -> list[Finding]:
    """Pairs of values of which one must lie below the other."""
    scan, heat, limits = recipe.scan, recipe.heat, recipe.limits
    engage = recipe.tighten.engage
    pairs = [
        ("scan.distance_low_mm", scan.distance_low_mm, scan.distance_high_mm, "mm"),
        ("tighten.engage.force_low_n", engage.force_low_n, engage.force_high_n, "N"),
        ("tighten.engage.nut_from_mm", engage.nut_from_mm, engage.nut_to_mm, "mm"),
        ("tighten.engage.nut_to_mm", engage.nut_to_mm, engage.edge_mm, "mm"),
        ("tighten.engage.edge_mm", engage.edge_mm, engage.engaged_mm, "mm"),
        ("limits.preload_low_n", limits.preload_low_n, limits.preload_high_n, "N"),
        ("heat.hold_force_n", heat.hold_force_n, heat.seat_force_limit_n, "N"),
        ("heat.difference_tolerance_k", heat.difference_tolerance_k, heat.difference_k, "K"),
        ("heat.max_spread_k", heat.max_spread_k, heat.channel_gate_k, "K"),
    ]
    pairs += [
        (f"tighten.stages.{number}.angle_low_deg", stage.angle_low_deg, stage.angle_high_deg, "deg")
        for number, stage in enumerate(recipe.tighten.stages)
    ]
    return [
        Finding("limit_order", place, f"{low:g} does not lie below {high:g}", f"< {high:g}", unit)
        for place, low, high, unit in pairs
        if not low < high
    ]
