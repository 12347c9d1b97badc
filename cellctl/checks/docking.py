"""Can the studs enter below the force limit? Trip force, contact speed, alignment gates."""

from __future__ import annotations

import math

from cellctl.checks.finding import Finding
from cellctl.checks.heating import growth_mm
from cellctl.recipe import Recipe
from hal.config import CellConfig, Delays

USABLE_SHARE = 0.1
"""A trip below a tenth of the force limit trips on noise and guide friction before it trips on contact."""


def trip_n(
    limit_n: float,
    speed_mm_s: float,
    delays: Delays,
    *,
    stiffness_n_per_mm: float,
    mass_kg: float,
    deceleration_mm_s2: float | None = None,
) -> float:
    """Net force at which the guard must trip so that the force stays below `limit_n`, overshoot included.

    F_trip = F_limit - k v (t_sensor + t_guard + t_bus + t_drive) - max(k v^2 / 2a, v sqrt(k m)) - u_tare - 4 sigma,
    with k the axial stiffness, v the contact speed, m the moving mass, a the drive's deceleration. May be negative:
    then no trip is early enough.
    """
    delay_s = delays.sensor_s + delays.guard_s + delays.bus_s + delays.drive_s
    during_delay = stiffness_n_per_mm * speed_mm_s * delay_s
    carried = 1e-3 * speed_mm_s * math.sqrt(1e3 * stiffness_n_per_mm * mass_kg)
    braking = stiffness_n_per_mm * speed_mm_s**2 / (2.0 * deceleration_mm_s2) if deceleration_mm_s2 else 0.0
    margin = delays.tare_n + 4.0 * delays.noise_n
    return limit_n - during_delay - max(braking, carried) - margin


def usable_trip_n(limit_n: float, delays: Delays) -> float:
    """The lowest net force at which a trip can be told from noise."""
    return max(USABLE_SHARE * limit_n, delays.tare_n + 4.0 * delays.noise_n)


def trip_force_n(recipe: Recipe, delays: Delays, mass_kg: float, *, deceleration_mm_s2: float | None = None) -> float:
    """`trip_n` for the recipe's insertion."""
    return trip_n(
        recipe.jack_up.force_limit_n,
        recipe.jack_up.contact_speed_mm_s,
        delays,
        stiffness_n_per_mm=recipe.limits.axial_stiffness_n_per_mm,
        mass_kg=mass_kg,
        deceleration_mm_s2=deceleration_mm_s2,
    )


def insertion_trip_n(recipe: Recipe, cell: CellConfig) -> float:
    """`trip_force_n` in that cell: what is armed for the insertion, and what the check judges.

    A force that passes the trip right after a sample is seen in the next one: its period is part of the sensor's delay.
    The jack is taken to stop no harder than it ramps; most drives' quick stop is shorter.
    """
    period_s = 1.0 / cell.devices.jack_force.rate_hz
    delays = cell.guard.model_copy(update={"sensor_s": cell.guard.sensor_s + period_s})
    deceleration = cell.devices.jack.max_acceleration
    return trip_force_n(recipe, delays, cell.cell.moving_mass_kg, deceleration_mm_s2=deceleration)


def contact_speed_findings(recipe: Recipe, cell: CellConfig | None) -> list[Finding]:
    """The contact speed must leave a trip force that can be told from noise."""
    delays = cell.guard if cell else Delays()
    trip = insertion_trip_n(recipe, cell) if cell else trip_force_n(recipe, delays, recipe.limits.shaft_mass_kg)
    usable = usable_trip_n(recipe.jack_up.force_limit_n, delays)
    if trip >= usable:
        return []
    text = f"{recipe.jack_up.contact_speed_mm_s} mm/s leaves a trip force of {trip:.2f} N"
    return [Finding("contact_speed", "jack_up.contact_speed_mm_s", text, f">= {usable:.2f}", "N")]


def gate_findings(recipe: Recipe) -> list[Finding]:
    """A pose at the edge of the gates, at docking temperature, must still leave every stud free."""
    gates, clearance = recipe.align, recipe.limits.radial_clearance_mm
    along = gates.gate_xy_mm + growth_mm(recipe, recipe.heat.difference_k)
    across = 0.5 * recipe.pattern.circle_diameter_mm * math.radians(gates.gate_theta_deg)
    offset = math.hypot(along, across)
    if offset < clearance:
        return []
    text = f"a pose at the edge of the gates puts a stud {offset:.3f} mm off"
    return [Finding("align_gate", "align.gate_xy_mm", text, f"< {clearance}", "mm")]
