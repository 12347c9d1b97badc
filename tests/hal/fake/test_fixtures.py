"""Weights and the mandrel in the twin: what they weigh, what the probes see of them, what they must not meet."""

from __future__ import annotations

import numpy as np
import pytest

from hal.fake.fixtures import Mandrel, draw_mandrel, weight_kg
from hal.fake.scene.picture import picture_of
from tests.hal.fake.bench_plant import plant_of


def test_a_weight_weighs_what_its_name_says() -> None:
    assert weight_kg(1, "CAL-WEIGHT-40") == pytest.approx(40.0, rel=1e-4)
    assert weight_kg(1, "CAL-WEIGHT-0") == 0.0
    assert weight_kg(1, "S-1") is None
    assert weight_kg(1, "CAL-WEIGHT-heavy") is None
    plant = plant_of("ideal")
    plant.load_parts("-", "CAL-WEIGHT-40")
    assert plant.jack_force_n(np.array([0.0]))[0] == pytest.approx(40.0 * 9.80665, rel=1e-4)


def test_a_fixture_meets_no_rotor_and_is_gone_with_the_next_part() -> None:
    plant = plant_of("ideal")
    plant.load_parts("-", "CAL-MANDREL")
    assert picture_of(plant, "shaft", 10_000).parts == ()
    plant.start_move("jack", 399.0, speed=20.0, acceleration=50.0, now=0.0)
    plant.advance(60.0)
    assert plant.gap_mm() == pytest.approx(1.0)
    assert not plant.damages
    plant.load_parts("R-1", "S-1")
    assert plant.probe_mm(0) is None
    assert len(picture_of(plant, "shaft", 10_000).parts) == 2


def test_probes_see_the_stage_and_the_jacks_lean() -> None:
    plant = plant_of("ideal", overrides={"jack_line_tilt_x_deg": 0.05})
    plant.load_parts("-", "CAL-MANDREL")
    start = np.array([plant.probe_mm(i) for i in range(3)])
    plant.start_move("stage_x", 0.2, speed=5.0, acceleration=20.0, now=0.0)
    plant.advance(10.0)
    stepped = np.array([plant.probe_mm(i) for i in range(3)])
    assert stepped - start == pytest.approx([-0.2, 0.1, 0.1], abs=0.01)
    plant.start_move("jack", 300.0, speed=20.0, acceleration=50.0, now=10.0)
    plant.advance(60.0)
    lean = 300.0 * np.tan(np.radians(0.05))
    assert np.array([plant.probe_mm(i) for i in range(3)]) - stepped == pytest.approx(
        [-lean, 0.5 * lean, 0.5 * lean], abs=0.02 + 300.0 * 5e-4
    )


def test_a_camera_that_swings_into_the_mandrel_is_damage() -> None:
    plant = plant_of("ideal")
    plant.load_parts("-", "CAL-MANDREL")
    plant.camera = "shaft"
    plant.advance(1.0)
    assert plant.damages == ["the mandrel hit the camera's arm"]


def test_the_cylinder_is_round() -> None:
    mandrel = Mandrel(np.zeros(2), np.zeros(2), np.zeros(3), np.ones(3))
    assert mandrel.probe_mm(0, np.array([0.0, 3.0])) == pytest.approx(41.0 - np.sqrt(40.0**2 - 3.0**2))
    assert draw_mandrel(1, "CAL-MANDREL", np.zeros(2)).foot_mm == pytest.approx(
        draw_mandrel(1, "CAL-MANDREL", np.ones(2)).foot_mm - 1.0
    )
