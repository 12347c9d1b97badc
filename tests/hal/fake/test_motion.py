"""Motion profiles: exact, bounded, remembered."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.fake.motion import AxisMotion, dropping, standing, stopping, trapezoid

real = st.floats(-400.0, 400.0)


@given(start=real, target=real, speed=st.floats(0.05, 50.0), acceleration=st.floats(1.0, 400.0))
def test_a_profile_keeps_its_limits_and_arrives(start: float, target: float, speed: float, acceleration: float) -> None:
    path = trapezoid(start, target, speed, acceleration, 5.0)
    time = np.linspace(4.0, path.end_s + 1.0, 2000)
    assert np.abs(path.velocity_at(time)).max() <= speed * (1.0 + 1e-9)
    assert np.abs(path.acceleration_at(time)).max() <= acceleration
    assert path.position_at(np.array([0.0, path.end_s + 1e-9])) == pytest.approx([start, target], abs=1e-9)
    low, high = sorted((start, target))
    assert path.position_at(time).min() >= low - 1e-6
    assert path.position_at(time).max() <= high + 1e-6


def test_position_is_the_integral_of_velocity() -> None:
    path = trapezoid(2.0, 17.0, 4.0, 3.0, 1.0)
    time = np.linspace(1.0, path.end_s, 200_001)
    velocity = path.velocity_at(time)
    integral = 2.0 + np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    assert path.position_at(time) == pytest.approx(integral, abs=1e-6)
    # 4 mm/s over 15 mm with ramps of 4/3 s each
    assert path.end_s == pytest.approx(1.0 + 15.0 / 4.0 + 4.0 / 3.0)


def test_one_time_gives_what_the_array_gives() -> None:
    path = trapezoid(0.0, -3.0, 1.0, 2.0, 0.0)
    for time in (-1.0, 0.0, 0.3, 1.0, 3.2, 9.0):
        expected = (path.position_at([time])[0], path.velocity_at([time])[0], path.acceleration_at([time])[0])
        assert path.at(time) == pytest.approx(expected)


def test_a_quick_stop_runs_on_by_v2_over_2a() -> None:
    path = stopping(10.0, -4.0, 50.0, 2.0)
    assert path.target == pytest.approx(10.0 - 16.0 / 100.0)
    assert path.end_s == pytest.approx(2.08)


def test_a_late_brake_lets_the_load_fall_by_half_g_t2_but_not_through_the_floor() -> None:
    path = dropping(standing(300.0, 1.0), 9806.65, 0.05, 0.0)
    assert path.target == pytest.approx(300.0 - 0.5 * 9806.65 * 0.05**2)
    assert path.end_s == pytest.approx(1.05)
    assert dropping(standing(2.0, 1.0), 9806.65, 0.05, 0.0).target == pytest.approx(0.0)
    after_stop = dropping(stopping(10.0, 4.0, 50.0, 0.0), 9806.65, 0.01, 0.0)
    assert after_stop.position_at(np.array([0.08])) == pytest.approx([10.16])
    assert after_stop.end_s == pytest.approx(0.09)


def test_stopping_on_the_way_replaces_the_profile_and_keeps_the_past() -> None:
    axis = AxisMotion()
    axis.move(100.0, 10.0, 50.0, 0.0)
    before = axis.position(3.0)
    version = axis.version
    axis.stop(50.0, 4.0, 0.05)
    assert axis.version > version
    assert axis.position(3.0) == before
    assert axis.positions(np.array([3.0, 4.0, 9.0])) == pytest.approx([before, 39.0, 40.0])
    assert not axis.moving(4.21)
    assert axis.brake_closes_s == pytest.approx(4.25)
    assert axis.velocities(np.array([3.9, 4.1])) == pytest.approx([10.0, 5.0])


def test_a_new_target_starts_where_the_axis_stands() -> None:
    axis = AxisMotion()
    axis.move(10.0, 10.0, 50.0, 0.0)
    axis.stop(50.0, 0.5, 0.05)
    here = axis.position(2.0)
    axis.move(0.0, 5.0, 50.0, 2.0)
    assert axis.position(2.0) == here
    assert axis.direction == -1.0
    assert axis.position(20.0) == 0.0
