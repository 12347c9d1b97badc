from pathlib import Path

import pytest

from cellctl.calibration import load_calibration
from cellctl.checks.tightening import expected_preload_n, lone_joints
from cellctl.recipe import load_recipe, parse_recipe
from cellctl.recipe_checks import CHECK_NAMES, check
from hal.config import CellConfig, load_cell
from tests.test_recipe import ROOT, lpt

CELL = load_cell(ROOT / "deploy" / "cell.fake.toml")
CALIBRATION = load_calibration(CELL.calibration_path)


def cell_with(**devices: dict[str, float]) -> CellConfig:
    changed = {name: getattr(CELL.devices, name).model_copy(update=values) for name, values in devices.items()}
    return CELL.model_copy(update={"devices": CELL.devices.model_copy(update=changed)})


@pytest.mark.parametrize("name", ["lpt_shaft_36", "compressor_drum_24"])
def test_the_assemblies_of_the_house_pass_on_the_fake_cell(name: str) -> None:
    assert check(load_recipe(ROOT / "recipes" / f"{name}.toml"), CELL, CALIBRATION) == ()


def test_a_recipe_that_only_measures_has_its_geometry_checked_and_cannot_run() -> None:
    recipe = load_recipe(ROOT / "recipes" / "flange_iso9409_50_4.toml")
    assert check(recipe) == ()
    assert [finding.name for finding in check(recipe, CELL)] == ["parts"]


COLD = ("enabled = true", "enabled = false")
BROKEN = {
    "cold_interference": [COLD],
    "temperature_window": [("difference_k = 45.0", "difference_k = 40.0")],
    "contact_speed": [("contact_speed_mm_s = 0.2", "contact_speed_mm_s = 0.4")],
    "heated_member": [('member = "shaft"', 'member = "rotor"')],
    "stages": [("torque_nm = 18.0", "torque_nm = 9.0")],
    "opposite_pairs": [("count = 36", "count = 35")],
    "stud_length": [("length_mm = 32.0", "length_mm = 24.0")],
    "hole_clearance": [("radial_clearance_mm = 0.15", "radial_clearance_mm = 0.2")],
    "preload": [("preload_low_n = 10000.0", "preload_low_n = 30000.0")],
    "temperature_limit": [("max_temperature_c = 120.0", "max_temperature_c = 65.0")],
    "heat_timeout": [("timeout_s = 1800.0", "timeout_s = 300.0")],
    "seat_window": [("seat_speed_mm_s = 1.0", "seat_speed_mm_s = 0.4")],
    "align_gate": [("gate_theta_deg = 0.03", "gate_theta_deg = 0.08"), ("difference_k = 45.0", "difference_k = 42.0")],
    "limit_order": [("force_low_n = 5.0", "force_low_n = 90.0")],
    "pattern_overlap": [("count = 36", "count = 80")],
    "face": [("circle_diameter_mm = 240.0", "circle_diameter_mm = 275.0")],
    "chamfer": [("chamfer_diameter_mm = 9.9", "chamfer_diameter_mm = 8.3")],
    "thread_size": [("major_diameter_mm = 8.0", "major_diameter_mm = 10.0")],
    "features": [('feature = "stud"', 'feature = "hole"')],
    "sizes_missing": [("length_mm = 32.0\n", "")],
    "spigot_fit": [("spigot_diameter_mm = 180.0", "spigot_diameter_mm = 181.0")],
    "heater_power": [("max_power_w = 3000.0", "max_power_w = 5000.0")],
    "scan_distance": [("distance_low_mm = 300.0", "distance_low_mm = 360.0")],
    "cell_limits": [("approach_speed_mm_s = 10.0", "approach_speed_mm_s = 30.0")],
}


@pytest.mark.parametrize("name", sorted(BROKEN))
def test_each_check_finds_its_fault_and_says_where(name: str) -> None:
    recipe = parse_recipe(lpt(*BROKEN[name]))
    found = [finding for finding in check(recipe, CELL, CALIBRATION) if finding.name == name]
    assert found
    for finding in found:
        assert finding.place
        assert finding.reason
        assert finding.name in CHECK_NAMES
        assert f"[{name}]" in str(finding)


def test_every_name_is_tested_and_stable() -> None:
    assert set(CHECK_NAMES) == {*BROKEN, "parts", "views"}
    assert list(CHECK_NAMES) == sorted(CHECK_NAMES)


def test_cold_seating_is_allowed_where_nuts_draw_in_or_the_fit_is_loose() -> None:
    drawn = parse_recipe(lpt(COLD, ("draw_in = false", "draw_in = true")))
    tolerance = ("fit_tolerance_mm = 0.005", "fit_tolerance_mm = 0.0")
    loose = parse_recipe(lpt(COLD, ("fit_interference_mm = 0.06", "fit_interference_mm = 0.0"), tolerance))
    assert check(drawn, CELL, CALIBRATION) == ()
    assert check(loose, CELL, CALIBRATION) == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([("difference_k = 45.0", "difference_k = 40.0")], "not open"),
        ([("difference_k = 45.0", "difference_k = 70.0")], "reaches the studs"),
        ([("fit_interference_mm = 0.06", "fit_interference_mm = 0.12")], "empty"),
    ],
)
def test_the_temperature_window_from_both_sides(changes: list[tuple[str, str]], said: str) -> None:
    names = [(f.name, f.reason) for f in check(parse_recipe(lpt(*changes)))]
    assert [reason for name, reason in names if name == "temperature_window" and said in reason]


@pytest.mark.parametrize(
    ("cell", "place"),
    [
        (cell_with(jack={"high": 390.0}), "heat.seat_travel_mm"),
        (cell_with(gun_table={"high": 180.0}), "pattern.angles_deg"),
        (cell_with(shaft_table={"low": 0.0, "high": 5.0}), "pattern.angles_deg"),
        (cell_with(jack_force={"range_n": 1000.0}), "limits.shaft_mass_kg"),
        (cell_with(gun_force_b={"range_n": 50.0}), "tighten.engage.force_high_n"),
        (cell_with(gun_feed={"max_speed": 1.0}), "tighten.engage.feed_speed_mm_s"),
        (cell_with(gun_feed={"high": 90.0}), "tighten.engage.engaged_mm"),
    ],
)
def test_what_the_cell_cannot_do_is_refused(cell: CellConfig, place: str) -> None:
    findings = check(parse_recipe(lpt()), cell, CALIBRATION)
    assert [(finding.name, finding.place) for finding in findings] == [("cell_limits", place)]


def test_a_calibration_without_a_view_is_refused() -> None:
    half = CALIBRATION.model_copy(update={"views": {"rotor": CALIBRATION.views["rotor"]}})
    assert [finding.name for finding in check(parse_recipe(lpt()), CELL, half)] == ["views"]


def test_a_slow_chain_of_delays_is_a_matter_of_the_contact_speed() -> None:
    slow = CELL.model_copy(update={"guard": CELL.guard.model_copy(update={"drive_s": 0.05})})
    assert [finding.name for finding in check(parse_recipe(lpt()), slow, CALIBRATION)] == ["contact_speed"]


def test_lone_joints() -> None:
    assert lone_joints((0.0, 90.0, 180.0, 270.0)) == ()
    assert lone_joints((0.0, 120.0, 240.0)) == (0, 1, 2)
    assert lone_joints((0.0, 90.0, 180.4, 271.0)) == (1, 3)
    assert lone_joints((0.2, 359.9 - 180.0)) == ()


def test_preload_by_the_textbook() -> None:
    # VDI 2230-1 by hand: M8x1, friction 0.14, D = 10.7: lever 0.1592 + 0.5942 + 0.7490 = 1.5023 mm.
    assert expected_preload_n(parse_recipe(lpt())) == pytest.approx(36.0e3 / 1.5023, rel=1e-3)


def test_all_findings_come_at_once() -> None:
    text = lpt(COLD, BROKEN["stages"][0], BROKEN["stud_length"][0], BROKEN["contact_speed"][0])
    names = {finding.name for finding in check(parse_recipe(text), CELL, CALIBRATION)}
    assert {"cold_interference", "stages", "stud_length", "contact_speed"} <= names


def test_paths_of_the_cell_resolve() -> None:
    assert CELL.calibration_path == Path(ROOT / "deploy" / "calibration.fake.toml")
