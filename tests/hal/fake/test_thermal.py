"""The twin's heat against what the joint is known to do and against a measured heater."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import curve_fit

from hal.fake.heat.thermal import (
    ThermalProperties,
    Zones,
    at_rest,
    circle_growth,
    faces_w_per_k,
    film_w_per_m2_k,
    interference_mm,
    lagged,
    midpoint,
    pyrometer_c,
    spigot_w_per_k,
    step,
    step_response,
)

MEASURED = Path(__file__).parents[4] / "shared" / "data" / "heater" / "siso_step_test.csv"
JOINT = ThermalProperties()


def hot(difference_k: float) -> Zones:
    return Zones(20.0 + difference_k, 20.0 + difference_k, 20.0, 20.0)


def seconds_until_closed(difference_k: float, face_gap_mm: float = 0.0) -> float:
    zones, time_s = hot(difference_k), 0.0
    while interference_mm(JOINT, zones) < 0.0:
        zones, time_s = step(JOINT, zones, 0.0, face_gap_mm, 0.1), time_s + 0.1
        assert time_s < 3600.0
    return time_s


@pytest.mark.parametrize(("difference_k", "expected_s"), [(40.0, 8.0), (60.0, 16.0)])
def test_an_opened_fit_closes_in_the_time_that_is_known(difference_k: float, expected_s: float) -> None:
    assert seconds_until_closed(difference_k) == pytest.approx(expected_s, rel=0.15)


def test_a_spigot_stopped_halfway_is_gripped_too_but_later() -> None:
    assert seconds_until_closed(45.0) < seconds_until_closed(45.0, face_gap_mm=1.5) < 60.0


def test_in_the_spigot_the_difference_dies_within_some_twenty_seconds() -> None:
    zones = hot(40.0)
    for _ in range(200):
        zones = step(JOINT, zones, 0.0, 0.0, 0.1)
    assert 0.0 < zones.shaft_rim_c - zones.rotor_rim_c < 40.0 * np.exp(-1.0)


def test_free_members_cool_with_half_an_hour() -> None:
    zones = hot(45.0)
    for _ in range(1800):
        zones = step(JOINT, zones, 0.0, 300.0, 1.0)
    assert zones.shaft_rim_c - zones.rotor_rim_c == pytest.approx(45.0 * np.exp(-1.0), rel=0.03)


def test_interference_follows_the_difference() -> None:
    assert interference_mm(JOINT, at_rest(JOINT)) == 0.060
    assert interference_mm(JOINT, hot(80.0 / 3.0)) == pytest.approx(0.0, abs=1e-12)
    assert interference_mm(JOINT, hot(45.0)) == pytest.approx(0.060 - 12.5e-6 * 180.0 * 45.0)


@pytest.mark.parametrize(("difference_k", "growth_mm"), [(40, 0.060), (60, 0.090), (80, 0.120), (100, 0.150)])
def test_the_heated_hole_circle_grows_against_the_studs(difference_k: float, growth_mm: float) -> None:
    assert 120.0 * circle_growth(JOINT, hot(difference_k)) == pytest.approx(growth_mm, rel=1e-12)


def test_energy_is_kept_without_loss() -> None:
    closed = replace(JOINT, loss_time_s=1e15)
    capacities = np.array([50.0, 1800.0, 50.0, 3600.0])
    zones, before = hot(45.0), capacities @ np.array(hot(45.0))
    for _ in range(600):
        zones = step(closed, zones, 100.0, 0.0, 0.5)
    assert capacities @ np.array(zones) - before == pytest.approx(100.0 * 300.0, rel=1e-9)


def test_steps_of_the_grid_agree_with_fine_steps() -> None:
    coarse = fine = hot(45.0)
    for _ in range(40):
        coarse = step(JOINT, coarse, 50.0, 0.0, 0.5)
    for _ in range(2000):
        fine = step(JOINT, fine, 50.0, 0.0, 0.01)
    assert np.allclose(coarse, fine, atol=0.02)


def test_conductances_grow_as_gaps_shrink() -> None:
    films = [film_w_per_m2_k(JOINT, gap, 0.025) for gap in (0.0, 0.015, 0.0375)]
    assert films[0] == pytest.approx(0.027 / 25e-6) and films[0] > films[1] > films[2]
    assert spigot_w_per_k(JOINT, 3.0, 0.01) > spigot_w_per_k(JOINT, 3.0, -0.01) > spigot_w_per_k(JOINT, 1.5, -0.01) > 0
    assert spigot_w_per_k(JOINT, -1.0, -0.01) == 0.0
    assert faces_w_per_k(JOINT, 3.0) == pytest.approx(0.0361 * 0.027 / 3.025e-3, rel=0.01)


def test_the_eccentric_film_is_the_mean_over_the_circumference() -> None:
    phi = np.linspace(0.0, 2.0 * np.pi, 10_000, endpoint=False)
    mean = np.mean(0.027e3 / (0.02 + 0.025 + 0.02 * np.cos(phi)))
    assert film_w_per_m2_k(JOINT, 0.02, 0.025) == pytest.approx(mean, rel=1e-9)


def test_lag_is_exact_for_any_split_of_time() -> None:
    once = lagged(20.0, 65.0, 2.0, 3.0)
    twice = lagged(lagged(20.0, 65.0, 2.0, 1.0), 65.0, 2.0, 2.0)
    assert once == pytest.approx(twice) and lagged(20.0, 65.0, 0.0, 1.0) == 65.0


def test_a_pyrometer_with_its_own_emissivity_is_right_and_otherwise_low() -> None:
    assert pyrometer_c(65.0, 20.0, 0.95, 0.95) == pytest.approx(65.0)
    assert pyrometer_c(20.0, 20.0, 0.3, 0.95) == pytest.approx(20.0)
    assert pyrometer_c(65.0, 20.0, 0.60, 0.95) < 55.0


@pytest.mark.skipif(not MEASURED.exists(), reason=f"measured heater absent: {MEASURED}")
def test_first_order_with_dead_time_describes_a_measured_heater() -> None:
    time_s, drive, temperature_k = np.loadtxt(MEASURED, delimiter=",").T
    first = (time_s >= 11.04) & (time_s < 201.0) & (drive > 100)
    since, rise = time_s[first] - 11.04, temperature_k[first] - temperature_k[0]
    model = np.vectorize(step_response)
    fitted, _ = curve_fit(model, since, rise, p0=(40.0, 100.0, 10.0))
    assert fitted == pytest.approx([52.1, 127.0, 15.0], rel=0.1)
    assert np.sqrt(np.mean((model(since, *fitted) - rise) ** 2)) < 0.5


def test_a_look_between_two_steps_agrees_with_a_step() -> None:
    look, kept = midpoint(JOINT, hot(45.0), 50.0, 0.0, 0.4), step(JOINT, hot(45.0), 50.0, 0.0, 0.4)
    assert np.allclose(look, kept, atol=0.005)
    assert midpoint(JOINT, hot(45.0), 50.0, 0.0, 0.0) == hot(45.0)
