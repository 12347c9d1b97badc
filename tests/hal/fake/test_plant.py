"""The plant as a whole: gap, forces, heat, collisions, what belongs to which parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from hal.errors import ConfigError
from hal.fake.contact.engagement import present_error, ring_of
from hal.fake.plant import Plant, TwinSettings
from tests.hal.fake.bench_plant import align, equal_joint, go, plant_of

WEIGHT_N = 100.0 * 9.80665


@dataclass
class Hot:
    """Heat at one state."""

    circle_growth: float = 0.0
    interference_mm: float = -0.04
    shaft_c: float = 65.0
    rotor_c: float = 20.0

    def advance(self, now: float, gap_mm: float) -> None:
        """Steady."""


def contact_n(plant: Plant) -> float:
    return float(plant.jack_force_n(np.array([plant.now]))[0]) - WEIGHT_N


def test_an_unknown_override_is_refused() -> None:
    with pytest.raises(ConfigError, match="nothing"):
        Plant(equal_joint(), TwinSettings(overrides={"nothing": 1.0}))


def test_gap_follows_the_jack() -> None:
    plant = plant_of("ideal")
    assert plant.gap_mm() == pytest.approx(400.0)
    go(plant, "jack", 350.0)
    assert plant.gap_mm() == pytest.approx(50.0)
    go(plant, "jack", 380.0)
    assert plant.gap_mm() == pytest.approx(20.0)
    assert plant.T_cell_shaft()[2, 3] == pytest.approx(380.0)


def test_gap_probes_see_the_tilt_until_the_faces_align() -> None:
    plant = plant_of("ideal", overrides={"shaft_tilt_y_deg": 0.02})
    plant.thermal = Hot()
    slope = np.tan(np.radians(0.02))
    go(plant, "jack", 399.0)
    assert plant.gap_at(135.0, 0.0) - plant.gap_at(-135.0, 0.0) == pytest.approx(2 * 135.0 * slope, rel=1e-3)
    assert plant.gap_at(0.0, 100.0) == pytest.approx(1.0, abs=1e-4)
    go(plant, "jack", 400.5)
    assert [plant.gap_at(x, 0.0) for x in (-140.0, 0.0, 140.0)] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_standing_the_sensor_carries_the_weight() -> None:
    assert contact_n(plant_of("ideal")) == pytest.approx(0.0, abs=1e-6)


def test_acceleration_and_guides_show_in_the_force() -> None:
    plant = plant_of("ideal", overrides={"guide_friction_n": 2.0})
    plant.start_move("jack", 100.0, speed=10.0, acceleration=50.0, now=0.0)
    time = np.array([0.1, 5.0])
    force = plant.jack_force_n(time) - WEIGHT_N
    assert force == pytest.approx([100.0 * 0.05 + 2.0, 2.0], abs=0.25)
    plant.advance(20.0)
    plant.start_move("jack", 0.0, speed=10.0, acceleration=50.0, now=20.0)
    assert plant.jack_force_n(np.array([25.0]))[0] - WEIGHT_N == pytest.approx(-2.0, abs=0.25)


def test_a_well_aligned_shaft_goes_in_without_force() -> None:
    plant = plant_of()
    align(plant)
    go(plant, "jack", 396.0)
    assert plant.engagement.peak_n.max() == 0.0
    assert plant.engagement.entry_error is not None
    assert abs(plant.engagement.entry_error.x_mm) < 0.02


@pytest.mark.parametrize(("x_mm", "theta_deg"), [(0.2, 0.0), (0.0, 0.12)])
def test_a_misaligned_shaft_is_felt_and_remembered(x_mm: float, theta_deg: float) -> None:
    plant = plant_of()
    align(plant, x_mm=x_mm, theta_deg=theta_deg)
    go(plant, "jack", 396.0)
    peaks = plant.engagement.peak_n
    assert peaks.max() > 10.0
    assert plant.engagement.peak_total_n >= peaks.max()
    assert plant.engagement.peak_total_n <= peaks.sum() + 1e-6
    error = plant.engagement.entry_error
    assert error is not None
    assert (error.x_mm, error.theta_deg) == pytest.approx((x_mm, theta_deg), abs=0.02)


def test_peaks_do_not_depend_on_how_often_the_plant_is_asked() -> None:
    peaks = []
    for step_s in (0.013, 1.7, 1000.0):
        plant = plant_of()
        align(plant, x_mm=0.2)
        end_s = plant.start_move("jack", 396.0, speed=5.0, acceleration=50.0, now=plant.now).end_s
        for time in np.append(np.arange(plant.now, end_s, step_s), end_s):
            plant.advance(float(time))
        peaks.append(plant.engagement.peak_n)
    assert peaks[1] == pytest.approx(peaks[0], abs=0.05)
    assert peaks[2] == pytest.approx(peaks[0], abs=0.05)


def test_a_jammed_shaft_stays_while_the_column_yields() -> None:
    plant = plant_of("ideal")
    align(plant, x_mm=1.7)
    go(plant, "jack", 368.5)
    assert plant.gap_mm() == pytest.approx(32.0, abs=1e-3)
    assert contact_n(plant) == pytest.approx(0.5 * 1350.0, rel=0.01)
    go(plant, "jack", 395.0)
    assert plant.gap_mm() == pytest.approx(32.0, abs=1e-3)
    assert plant.damages


def test_a_cold_fit_is_not_seated_with_the_seating_force() -> None:
    plant = plant_of("ideal")
    go(plant, "jack", 397.6)
    assert contact_n(plant) > 30.0
    go(plant, "jack", 398.2)
    assert contact_n(plant) > 300.0
    assert plant.gap_mm() > 1.8


def test_an_open_fit_is_seated_with_little_force_and_seating_is_no_peak() -> None:
    plant = plant_of()
    align(plant)
    go(plant, "jack", 396.0)
    plant.thermal = Hot(circle_growth=45.0 * 12.5e-6)
    go(plant, "jack", 400.4)
    assert plant.gap_mm() == 0.0
    assert contact_n(plant) > 100.0
    assert plant.engagement.peak_n.max() < 10.0


def test_a_fit_that_shrinks_onto_the_seated_shaft_pushes_nothing_out_and_lets_go_when_pulled() -> None:
    plant = plant_of("ideal")
    heat = Hot()
    plant.thermal = heat
    go(plant, "jack", 400.1)
    assert plant.gap_mm() == pytest.approx(0.0, abs=1e-6)
    heat.interference_mm, heat.shaft_c = 0.06, 20.0
    plant.advance(plant.now + 600.0)
    assert plant.gap_mm() == pytest.approx(0.0, abs=1e-6)
    assert plant.T_cell_shaft()[2, 3] == pytest.approx(400.0, abs=1e-6)
    heat.interference_mm = -0.04
    go(plant, "jack", 390.0)
    assert plant.gap_mm() == pytest.approx(10.0, abs=1e-3)


def test_growing_holes_press_on_the_studs_while_the_jack_stands() -> None:
    plant = plant_of()
    align(plant)
    go(plant, "jack", 396.0)
    assert plant.engagement.lateral_peak_n.max() == 0.0
    plant.thermal = Hot(circle_growth=90.0 * 12.5e-6, interference_mm=-0.1)
    plant.advance(plant.now + 10.0)
    assert plant.engagement.lateral_peak_n.max() > 5.0


def test_a_stage_that_moves_with_the_studs_inside_ruins_them() -> None:
    plant = plant_of()
    align(plant)
    go(plant, "jack", 390.0)
    go(plant, "stage_x", plant.motors().x_mm + 2.5)
    assert plant.engagement.lateral_peak_n.max() > 500.0
    assert plant.damages
    assert contact_n(plant) > 100.0
    assert plant.gap_mm() == pytest.approx(10.0 + contact_n(plant) / 1350.0, abs=0.02)


def test_stopping_on_a_contact_swings_on_by_v_sqrt_km() -> None:
    ring = ring_of(1350.0, 100.0, 0.2, 1e6, 0.0, 0.0)
    assert ring is not None
    assert 1350.0 * ring.peak_mm == pytest.approx(0.2e-3 * np.sqrt(1350e3 * 100.0), rel=1e-3)
    soft = ring_of(1350.0, 100.0, 0.2, 0.5, 0.0, 0.0)
    assert soft is not None
    assert soft.peak_mm < 0.1 * ring.peak_mm
    assert ring_of(0.0, 100.0, 0.2, 50.0, 0.1, 0.0) is None
    assert ring_of(1350.0, 100.0, -0.2, 50.0, 0.1, 0.0) is None


def test_a_stop_in_contact_overshoots_in_force_and_truth() -> None:
    plant = plant_of("ideal")
    align(plant, x_mm=0.6)
    go(plant, "jack", 368.9)
    plant.start_move("jack", 396.0, speed=0.2, acceleration=2.0, now=plant.now)
    plant.advance(plant.now + 0.5)
    before = plant.engagement.peak_total_n
    plant.stop("jack", 200.0, plant.now)
    swing = plant.jack_force_n(plant.now + np.linspace(0.0, 0.3, 301)) - WEIGHT_N
    assert swing.max() > before + 1.0
    assert plant.engagement.peak_total_n == pytest.approx(swing.max(), rel=0.02)
    assert swing[-1] < swing.max() - 1.0


def test_other_parts_come_fresh_and_repeatably() -> None:
    plant = plant_of()
    align(plant, x_mm=0.3)
    go(plant, "jack", 396.0)
    plant.load_parts("R-2", "S-2")
    holes = plant.shaft.hole_mm
    assert plant.engagement.peak_n.max() == 0.0
    plant.load_parts("R-3", "S-3")
    assert (plant.shaft.hole_mm != holes).any()
    plant.load_parts("R-2", "S-2")
    assert (plant.shaft.hole_mm == holes).all()


def test_a_turned_shaft_is_turned_in_its_chuck() -> None:
    plant = plant_of()
    align(plant)
    plant.turn_shaft(0.05)
    assert present_error(plant.dock()).theta_deg == pytest.approx(0.05, abs=1e-3)


def test_the_camera_in_the_way_is_hit() -> None:
    plant = plant_of("ideal")
    plant.camera = "shaft"
    go(plant, "jack", 20.0)
    assert plant.damages == []
    go(plant, "jack", 60.0)
    assert plant.damages == ["the shaft hit the camera's arm"]


def test_guns_that_turn_while_fed_hit_the_nuts() -> None:
    plant = plant_of("ideal")
    go(plant, "gun_table", 90.0)
    go(plant, "gun_feed", 100.0)
    assert plant.damages == []
    go(plant, "gun_table", 100.0)
    assert plant.damages == ["the guns turned into the nuts"]


def test_a_late_brake_drops_the_load() -> None:
    plant = plant_of("ideal", overrides={"brake_late_s": 0.03})
    go(plant, "jack", 300.0)
    plant.cut_power("jack", 200.0, plant.now)
    plant.advance(plant.now + 1.0)
    assert plant.motion["jack"].position(plant.now) == pytest.approx(300.0 - 0.5 * 9806.65 * 0.03**2)
    assert plant.damages == ["the load was dropped"]
    held = plant_of("ideal")
    go(held, "jack", 300.0)
    held.cut_power("jack", 200.0, held.now)
    held.advance(held.now + 1.0)
    assert held.motion["jack"].position(held.now) == 300.0


def test_listeners_hear_of_motions_until_they_leave() -> None:
    plant, heard = plant_of("ideal"), []
    leave = plant.subscribe(lambda: heard.append(plant.now))
    go(plant, "stage_x", 1.0)
    leave()
    go(plant, "stage_x", 2.0)
    assert len(heard) == 1
