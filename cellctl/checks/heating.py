"""Can the spigot go home? Interference, the two-sided temperature window, what heating takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cellctl.checks.finding import Finding
from cellctl.recipe import Recipe
from hal.config import CellConfig

REFERENCE_C = 20.0
"""Reference temperature of sizes (ISO 1), taken for the shop's."""
COVERAGE = 3.0


@dataclass(frozen=True, slots=True)
class Window:
    """Differences of temperature between the members, kelvin: from where the fit is open, to where studs are free."""

    low_k: float
    high_k: float


def temperature_window(recipe: Recipe) -> Window | None:
    """The window by the drawing; None where nothing is heated or a size is missing.

    Low: the diametral fit opens by `open_by_mm`, interference_now = interference - alpha D dT, the largest fit taken.
    High: the hole circle has grown by alpha R dT in radius, and the worst stud still keeps `clearance_sigmas`.
    Each gate counts as three sigma of its alignment, `position_sigma_mm` is that of a hole and of a stud.
    """
    spigot = recipe.shaft.spigot_diameter_mm if recipe.shaft else None
    if not recipe.heat.enabled or spigot is None:
        return None
    heat = recipe.heat
    low = (heat.fit_interference_mm + heat.fit_tolerance_mm + heat.open_by_mm) / (heat.expansion_per_k * spigot)
    radius = 0.5 * recipe.pattern.circle_diameter_mm
    shift = math.hypot(recipe.align.gate_xy_mm / COVERAGE, math.sqrt(2.0) * recipe.limits.position_sigma_mm)
    across = math.hypot(shift, radius * math.radians(recipe.align.gate_theta_deg) / COVERAGE)
    clearance = recipe.limits.radial_clearance_mm
    room = math.sqrt(max(clearance**2 - across**2, 0.0)) - heat.clearance_sigmas * shift
    return Window(low, room / (heat.expansion_per_k * radius))


def growth_mm(recipe: Recipe, difference_k: float) -> float:
    """Growth of the heated member's bolt circle in radius against the other member."""
    heated = recipe.heat.enabled
    return recipe.heat.expansion_per_k * 0.5 * recipe.pattern.circle_diameter_mm * difference_k if heated else 0.0


def fit_heat_findings(recipe: Recipe) -> list[Finding]:
    """An interference fit needs heat or nuts that draw it in; heat must open it and keep the studs free."""
    heat = recipe.heat
    tightest = heat.fit_interference_mm + heat.fit_tolerance_mm
    if not heat.enabled:
        if tightest <= 0 or heat.draw_in:
            return []
        text = f"an interference of up to {tightest:.3f} mm is closed by neither heat nor draw-in"
        return [Finding("cold_interference", "heat.enabled", text, "true, or heat.draw_in")]
    if heat.member != "shaft":
        text = "the rotor carries the male half of the spigot: heating it closes the fit"
        return [Finding("heated_member", "heat.member", text, "shaft")]
    return _window_findings(recipe)


def _window_findings(recipe: Recipe) -> list[Finding]:
    window = temperature_window(recipe)
    if window is None:
        return []
    heat = recipe.heat
    name, place = "temperature_window", "heat.difference_k"
    if window.low_k >= window.high_k:
        text = f"empty: the fit opens at {window.low_k:.1f} K, the studs are free up to {window.high_k:.1f} K"
        return [Finding(name, place, text)]
    low, high = heat.difference_k - heat.difference_tolerance_k, heat.difference_k + heat.difference_tolerance_k
    limit = f"{window.low_k:.1f} to {window.high_k:.1f}"
    if low < window.low_k:
        return [Finding(name, place, f"at {low:.1f} K the fit is not open", limit, "K")]
    if high > window.high_k:
        return [Finding(name, place, f"at {high:.1f} K the grown hole circle reaches the studs", limit, "K")]
    return []


def heating_findings(recipe: Recipe) -> list[Finding]:
    """Temperatures, times and travel of heating and seating against the recipe's own limits."""
    heat = recipe.heat
    found = []
    travel_s = recipe.jack_up.spigot_gap_mm / heat.seat_speed_mm_s
    if travel_s > heat.seat_window_s:
        text = f"{recipe.jack_up.spigot_gap_mm} mm at {heat.seat_speed_mm_s} mm/s take {travel_s:.1f} s"
        found.append(Finding("seat_window", "heat.seat_speed_mm_s", text, f"<= {heat.seat_window_s}", "s"))
    if not heat.enabled:
        return found
    hottest = REFERENCE_C + heat.difference_k + heat.difference_tolerance_k + heat.max_spread_k
    if hottest > heat.max_temperature_c:
        text = f"the spigot reaches {hottest:.0f} C in a shop of {REFERENCE_C:.0f} C"
        found.append(Finding("temperature_limit", "heat.max_temperature_c", text, f">= {hottest:.0f}", "Cel"))
    needed_s = 60.0 * heat.difference_k / heat.ramp_k_per_min + heat.soak_s
    if needed_s >= heat.timeout_s:
        text = f"ramp and soak take {needed_s:.0f} s"
        found.append(Finding("heat_timeout", "heat.timeout_s", text, f"> {needed_s:.0f}", "s"))
    return found


def heater_findings(recipe: Recipe, cell: CellConfig) -> list[Finding]:
    """The heater must have the power that the recipe asks for."""
    power = cell.devices.heater.max_power_w
    if not recipe.heat.enabled or recipe.heat.max_power_w <= power:
        return []
    text = f"{recipe.heat.max_power_w:.0f} W is more than the heater has"
    return [Finding("heater_power", "heat.max_power_w", text, f"<= {power:.0f}", "W")]
