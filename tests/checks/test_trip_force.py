import math

import pytest

from cellctl.assembly import guard_plan
from cellctl.checks.docking import contact_speed_findings, trip_force_n
from cellctl.recipe import parse_recipe
from hal.config import Delays, load_cell
from tests.journeys.twin_runs import CELL
from tests.test_recipe import lpt


def test_the_designs_number_at_the_default_speed() -> None:
    assert trip_force_n(parse_recipe(lpt()), Delays(), 100.0) == pytest.approx(4.546, abs=1e-3)


def test_the_terms_one_by_one() -> None:
    recipe = parse_recipe(lpt())  # k = 1350 N/mm, v = 0.2 mm/s, limit 10 N
    silent = Delays(sensor_s=0.0, guard_s=0.0, bus_s=0.0, drive_s=0.0, noise_n=0.0, tare_n=0.0)
    carried = 0.2e-3 * math.sqrt(1.35e6 * 100.0)
    assert trip_force_n(recipe, silent, 100.0) == pytest.approx(10.0 - carried)
    assert trip_force_n(recipe, silent, 0.0) == pytest.approx(10.0)
    slow = silent.model_copy(update={"drive_s": 0.01})
    assert trip_force_n(recipe, slow, 0.0) == pytest.approx(10.0 - 1350.0 * 0.2 * 0.01)
    noisy = silent.model_copy(update={"noise_n": 0.5, "tare_n": 0.25})
    assert trip_force_n(recipe, noisy, 0.0) == pytest.approx(10.0 - 2.0 - 0.25)
    braking = 1350.0 * 0.2**2 / (2.0 * 5.0)
    assert trip_force_n(recipe, silent, 0.0, deceleration_mm_s2=5.0) == pytest.approx(10.0 - braking)
    assert trip_force_n(recipe, silent, 100.0, deceleration_mm_s2=5.0) == pytest.approx(10.0 - braking)
    assert trip_force_n(recipe, silent, 100.0, deceleration_mm_s2=50.0) == pytest.approx(10.0 - carried)


def test_faster_is_never_later() -> None:
    forces = [
        trip_force_n(parse_recipe(lpt(("contact_speed_mm_s = 0.2", f"contact_speed_mm_s = {speed}"))), Delays(), 100.0)
        for speed in (0.05, 0.1, 0.2, 0.4, 0.8)
    ]
    assert forces == sorted(forces, reverse=True)
    assert forces[-1] < 0


def test_what_is_armed_leaves_room_for_a_jack_that_brakes_slowly_as_the_check_does() -> None:
    recipe, cell = parse_recipe(lpt()), load_cell(CELL)
    jack = cell.devices.jack.model_copy(update={"max_acceleration": 4.0})
    lazy = cell.model_copy(update={"devices": cell.devices.model_copy(update={"jack": jack})})
    later = 1350.0 * 0.2**2 / (2.0 * 4.0) - 0.2e-3 * math.sqrt(1.35e6 * 100.0)
    quick_n, lazy_n = (guard_plan(recipe, one).insert_trip_n for one in (cell, lazy))
    assert lazy_n == pytest.approx(quick_n - later)
    slower = jack.model_copy(update={"max_acceleration": 2.0})
    lazier = cell.model_copy(update={"devices": cell.devices.model_copy(update={"jack": slower})})
    (finding,) = contact_speed_findings(recipe, lazier)
    assert f"{guard_plan(recipe, lazier).insert_trip_n:.2f} N" in finding.reason


def test_the_wait_for_the_next_sample_is_part_of_the_delay() -> None:
    recipe, cell = parse_recipe(lpt()), load_cell(CELL)
    sensor = cell.devices.jack_force.model_copy(update={"rate_hz": 500.0})
    slower = cell.model_copy(update={"devices": cell.devices.model_copy(update={"jack_force": sensor})})
    quick_n, slow_n = (guard_plan(recipe, one).insert_trip_n for one in (cell, slower))
    assert quick_n == pytest.approx(trip_force_n(recipe, cell.guard, 100.0) - 1350.0 * 0.2 * 0.001)
    assert slow_n == pytest.approx(quick_n - 1350.0 * 0.2 * 0.001)
