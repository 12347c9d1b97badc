"""Can this cell do it? Travel, speeds, forces and distances against the cell file and the calibration."""

from __future__ import annotations

from cellctl.calibration import Calibration
from cellctl.checks.finding import Finding
from cellctl.recipe import Recipe
from hal.config import CellConfig
from hal.units import GRAVITY_M_S2

NAME = "cell_limits"


def cell_findings(recipe: Recipe, cell: CellConfig) -> list[Finding]:
    """Axes and sensors must reach what the recipe asks."""
    return [*_speeds(recipe, cell), *_travel(recipe, cell), *_forces(recipe, cell)]


def _speeds(recipe: Recipe, cell: CellConfig) -> list[Finding]:
    devices = cell.devices
    asked = [
        ("jack_up.approach_speed_mm_s", recipe.jack_up.approach_speed_mm_s, devices.jack.max_speed),
        ("jack_up.contact_speed_mm_s", recipe.jack_up.contact_speed_mm_s, devices.jack.max_speed),
        ("heat.seat_speed_mm_s", recipe.heat.seat_speed_mm_s, devices.jack.max_speed),
        ("tighten.engage.feed_speed_mm_s", recipe.tighten.engage.feed_speed_mm_s, devices.gun_feed.max_speed),
    ]
    return [
        Finding(NAME, place, f"{speed} mm/s is faster than the axis", f"<= {limit}", "mm/s")
        for place, speed, limit in asked
        if speed > limit
    ]


def _travel(recipe: Recipe, cell: CellConfig) -> list[Finding]:
    devices = cell.devices
    found = []
    top = cell.cell.rotor_face_mm + recipe.heat.seat_travel_mm
    if not devices.jack.low <= 0.0 <= top <= devices.jack.high:
        text = f"the jack travels to {devices.jack.high} mm, seating may go to {top} mm"
        found.append(Finding(NAME, "heat.seat_travel_mm", text, f"<= {devices.jack.high}", "mm"))
    feed, engaged = devices.gun_feed, recipe.tighten.engage.engaged_mm
    if engaged > feed.high:
        text = f"the sockets are over the nuts at {engaged} mm, the feed ends at {feed.high} mm"
        found.append(Finding(NAME, "tighten.engage.engaged_mm", text, f"<= {feed.high}", "mm"))
    spread = devices.shaft_table.high - devices.shaft_table.low
    turn = 360.0 if recipe.pattern.index_feature is not None or recipe.pattern.angles_deg != "equal" else 0.0
    needed = turn or 360.0 / recipe.pattern.count
    if spread < needed:
        text = f"the shaft table turns by {spread} degrees, the pattern may need {needed:g}"
        found.append(Finding(NAME, "pattern.angles_deg", text, f"<= {spread}", "deg"))
    for angle in recipe.pattern.angles():
        table = devices.gun_table
        if not table.low <= angle % 360.0 <= table.high:
            text = f"the gun table does not reach {angle % 360.0:g} degrees"
            found.append(Finding(NAME, "pattern.angles_deg", text, f"{table.low} to {table.high}", "deg"))
            break
    return found


def _forces(recipe: Recipe, cell: CellConfig) -> list[Finding]:
    devices = cell.devices
    found = []
    weight = recipe.limits.shaft_mass_kg * GRAVITY_M_S2
    pushed = weight + max(recipe.jack_up.force_limit_n, recipe.heat.seat_force_limit_n, recipe.heat.hold_force_n)
    if pushed > devices.jack_force.range_n:
        text = f"weight and seating force are {pushed:.0f} N on the jack's sensor"
        found.append(Finding(NAME, "limits.shaft_mass_kg", text, f"<= {devices.jack_force.range_n:.0f}", "N"))
    reach = min(devices.gun_force_a.range_n, devices.gun_force_b.range_n)
    if recipe.tighten.engage.force_high_n > reach:
        text = "beyond the range of the guns' force sensors"
        found.append(Finding(NAME, "tighten.engage.force_high_n", text, f"<= {reach}", "N"))
    return found


def calibration_findings(recipe: Recipe, cell: CellConfig, calibration: Calibration) -> list[Finding]:
    """Both faces must stand in the distance window of the scan: the rotor's above, the shaft's with the jack at 0."""
    found = []
    low, high = recipe.scan.distance_low_mm, recipe.scan.distance_high_mm
    for view, face_mm in (("rotor", cell.cell.rotor_face_mm), ("shaft", 0.0)):
        pose = next((known for name, known in calibration.views.items() if name == view), None)
        if pose is None:
            found.append(Finding("views", "scan", f"the calibration has no view {view!r}"))
            continue
        distance = abs(face_mm - float(pose.matrix[2, 3]))
        if not low <= distance <= high:
            text = f"the {view}'s face is {distance:.0f} mm from the camera"
            found.append(Finding("scan_distance", "scan.distance_low_mm", text, f"{low:g} to {high:g}", "mm"))
    return found
