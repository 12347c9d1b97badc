"""What leaves the plant by its one door."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from hal.fake.plant import Plant
from hal.fake.truth import TruthLimits, truth_of
from tests.hal.fake.bench_plant import align, go, plant_of
from tests.hal.fake.test_plant import Hot


class Tight:
    """Nuts at one preload."""

    def __init__(self, preload_n: NDArray[np.float64], yielded: int | None = None) -> None:
        self._preload_n = preload_n
        self._yielded = np.arange(len(preload_n)) == yielded

    def preload_n(self) -> NDArray[np.float64]:
        return self._preload_n

    def yielded(self) -> NDArray[np.bool_]:
        return self._yielded


def assembled(*, x_mm: float = 0.0) -> Plant:
    plant = plant_of(seed=4)
    align(plant, x_mm=x_mm)
    go(plant, "jack", 396.0)
    plant.thermal = Hot(circle_growth=45.0 * 12.5e-6)
    go(plant, "jack", 400.4)
    plant.joints = Tight(np.full(36, 20_000.0))
    return plant


def test_a_sound_joint_is_good() -> None:
    truth = truth_of(assembled())
    assert truth.good, truth.reasons
    assert truth.inserted
    assert truth.seating_gap_mm < 0.01
    assert max(truth.peak_force_per_bolt_n) < 10.0
    assert abs(truth.x_error_mm) < 0.02
    assert truth.preload_n == (20_000.0,) * 36


def test_a_stud_above_ten_newton_before_seating_is_not_good() -> None:
    truth = truth_of(assembled(x_mm=0.2))
    assert not truth.good
    assert truth.x_error_mm == pytest.approx(0.2, abs=0.02)
    assert "before seating" in truth.reasons[0]


def test_studs_outside_are_not_inserted() -> None:
    plant = plant_of("ideal")
    go(plant, "jack", 368.5)
    assert not truth_of(plant).inserted
    go(plant, "jack", 372.0)
    assert truth_of(plant).inserted


def test_a_jammed_joint_is_not_inserted_however_far_the_jack_went() -> None:
    plant = plant_of("ideal")
    align(plant, x_mm=1.7)
    go(plant, "jack", 396.0)
    truth = truth_of(plant)
    assert not truth.inserted
    assert "not all studs are inserted" in truth.reasons


@pytest.mark.parametrize(("low", "stud", "reason"), [(9_000.0, 5, "preload outside"), (33_000.0, 7, "preload outside")])
def test_one_wrong_preload_is_named(low: float, stud: int, reason: str) -> None:
    plant = assembled()
    preload = np.full(36, 20_000.0)
    preload[stud] = low
    plant.joints = Tight(preload)
    truth = truth_of(plant)
    assert len(truth.reasons) == 1
    assert truth.reasons[0].startswith(reason)
    assert truth.reasons[0].endswith(f": {stud}")


def test_yield_open_gap_and_damage_are_reasons() -> None:
    plant = assembled()
    plant.joints = Tight(np.full(36, 20_000.0), yielded=3)
    plant.damage("the load was dropped")
    assert truth_of(plant).reasons == ("yielded or stripped: 3", "the load was dropped")
    open_ = plant_of("ideal")
    go(open_, "jack", 396.0)
    reasons = truth_of(open_, TruthLimits(preload_low_n=-1.0)).reasons
    assert len(reasons) == 1
    assert "apart" in reasons[0]


def test_it_is_plain_data_with_the_overrides() -> None:
    plant = plant_of("ideal", overrides={"force_gain": 1.1})
    data = json.loads(json.dumps(truth_of(plant).as_dict()))
    assert data["overrides"] == {"force_gain": 1.1}
    assert len(data["peak_force_per_bolt_n"]) == 36
    assert set(data) == {
        "good", "reasons", "theta_error_deg", "x_error_mm", "y_error_mm", "inserted",
        "peak_force_per_bolt_n", "seating_gap_mm", "preload_n", "overrides",
    }  # fmt: skip
