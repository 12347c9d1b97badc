"""The nuts of one plant: what they do to each other, and how they come off."""

from dataclasses import replace

import numpy as np
import pytest

from hal.fake.joints.joint import NutState
from hal.fake.joints.nuts import Nuts
from hal.fake.plant import Plant, TwinSettings
from tests.hal.fake.closed_joint import ALIGNED, GEOMETRY


def nuts(seed: int = 1, level: str = "nominal") -> Nuts:
    return Nuts(Plant(GEOMETRY, TwinSettings(seed=seed, level=level, overrides=ALIGNED)))  # type: ignore[arg-type]


def tight(preload_n: float) -> NutState:
    return NutState(present=True, climb_mm=16.4, preload_n=preload_n)


def test_what_one_gains_its_neighbours_lose_and_loosening_gives_nothing_back() -> None:
    pattern = nuts()
    pattern.put(0, tight(10_000.0))
    pattern.put(1, tight(10_000.0))
    after = pattern.preload_n()
    assert after[1] == 10_000.0 and 9_000.0 < after[0] < 9_700.0
    pattern.put(1, tight(0.0))
    assert pattern.preload_n()[0] == after[0]


def test_nobody_loses_more_than_it_has() -> None:
    pattern = nuts()
    pattern.put(0, tight(100.0))
    pattern.put(1, tight(30_000.0))
    assert pattern.preload_n()[0] == 0.0


def test_a_nut_turned_back_past_the_studs_end_comes_off() -> None:
    pattern = nuts()
    started = NutState(present=True, climb_mm=2.0)
    back = pattern.moved(started, -360.0, 0.0)
    assert back is not None and back.climb_mm == pytest.approx(1.0)
    assert pattern.moved(started, -800.0, 0.0) is None


def test_a_nut_climbs_no_further_than_its_seat_and_yields_at_its_limit() -> None:
    pattern = nuts()
    seated = pattern.moved(tight(20_000.0), 3600.0, pattern.properties.yield_n)
    assert seated is not None and seated.climb_mm == pytest.approx(16.4) and seated.yielded
    weak = pattern.moved(replace(tight(0.0), yield_share=0.4), 10.0, 0.5 * pattern.properties.yield_n)
    assert weak is not None and weak.yielded


def test_friction_scatters_by_level_and_is_the_joint_s_own() -> None:
    nominal = np.log([nuts(seed).fresh(joint, 0.0).friction for seed in range(8) for joint in range(36)])
    assert np.std(nominal) == pytest.approx(0.08, rel=0.15)
    assert nuts(level="ideal").fresh(3, 0.0).friction == 1.0
    assert nuts().fresh(3, 0.0) == nuts().fresh(3, 0.0) != nuts().fresh(4, 0.0)


def test_each_pass_has_its_own_friction() -> None:
    pattern = nuts()
    first = pattern.condition(0).friction
    pattern.state[0] = replace(pattern.state[0], passes=1)
    assert pattern.condition(0).friction != first


def test_stud_ends_hang_below_the_rotor() -> None:
    pattern = nuts()
    assert pattern.stud_end_mm.shape == (36, 3)
    assert pattern.stud_end_mm[:, 2] == pytest.approx(400.0 - 32.0)
    assert np.hypot(*pattern.stud_end_mm[:, :2].T) == pytest.approx(120.0, abs=0.1)
