"""One bolted joint: torque, preload, rotation, cooling, neighbours."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hal.fake.geometry import JointGeometry
from hal.fake.joints.joint import (
    NutState,
    cooled,
    drawn_in_n,
    elastic_n_per_deg,
    interaction,
    properties_of,
    rotation_deg,
    running_torque_nm,
    slip_deg,
    torque_per_n_mm,
    travel_left_mm,
)

GEOMETRY = JointGeometry(angles_deg=tuple(10.0 * i for i in range(36)))
M8 = properties_of(GEOMETRY)
NUT = NutState(present=True)


def test_sizes_of_m8x1_are_those_of_the_standards() -> None:
    assert M8.pitch_diameter_mm == pytest.approx(7.350, abs=1e-3)
    assert M8.yield_n == pytest.approx(1030 * 39.17 / 1.2, rel=1e-3)
    assert M8.travel_mm == pytest.approx(32.0 - 14.0 - 1.6)
    assert 1.0e5 < M8.stiffness_n_per_mm < 3.5e5


def test_torque_follows_the_handbook_formula() -> None:
    by_hand = 0.159155 * 1.0 + 0.577350 * 0.14 * M8.pitch_diameter_mm + 0.5 * 0.14 * M8.bearing_diameter_mm
    assert torque_per_n_mm(M8, NUT) == pytest.approx(by_hand, rel=1e-5)
    assert (36.0 - M8.prevailing_nm) / torque_per_n_mm(M8, NUT) * 1e3 == pytest.approx(22_300, rel=0.01)


def test_friction_and_a_missing_washer_raise_the_lever() -> None:
    plain = torque_per_n_mm(M8, NUT)
    assert torque_per_n_mm(M8, replace(NUT, friction=1.08)) > plain
    assert torque_per_n_mm(M8, NUT, friction=1.08) == pytest.approx(torque_per_n_mm(M8, replace(NUT, friction=1.08)))
    assert torque_per_n_mm(M8, replace(NUT, washer=False)) > plain


def test_rotation_beds_in_and_then_is_elastic() -> None:
    slope, bedded = elastic_n_per_deg(M8), 0.5 * elastic_n_per_deg(M8) * M8.bedding_deg
    assert rotation_deg(M8, 0.0) == 0.0
    assert rotation_deg(M8, bedded) == pytest.approx(M8.bedding_deg)
    assert rotation_deg(M8, bedded - 1e-6) == pytest.approx(rotation_deg(M8, bedded + 1e-6), abs=1e-6)
    assert rotation_deg(M8, 20_000.0) - rotation_deg(M8, 10_000.0) == pytest.approx(10_000.0 / slope)


def test_travel_is_longer_without_washer_and_shorter_with_a_gap() -> None:
    assert travel_left_mm(M8, NUT, 0.0) == pytest.approx(16.4)
    assert travel_left_mm(M8, replace(NUT, climb_mm=2.0), 0.5) == pytest.approx(13.9)
    assert travel_left_mm(M8, replace(NUT, washer=False), 0.0) == pytest.approx(18.0)
    assert travel_left_mm(M8, replace(NUT, climb_mm=20.0), 0.0) == 0.0


def test_the_locking_element_bites_after_some_turns() -> None:
    torque = running_torque_nm(M8, np.array([0.0, 5.9, 6.25, 6.6, 16.0]))
    assert torque[0] == torque[1] == M8.free_torque_nm
    assert M8.free_torque_nm < torque[2] < torque[3] == torque[4] == M8.prevailing_nm


def test_cooling_of_the_flange_takes_preload() -> None:
    tight = replace(NUT, preload_n=20_000.0)
    lost = tight.preload_n - cooled(M8, tight, -40.0).preload_n
    assert lost == pytest.approx(M8.stiffness_n_per_mm * 12.5e-6 * 15.6 * 40.0)
    assert cooled(M8, replace(NUT, preload_n=10.0), -40.0).preload_n == 0.0
    assert cooled(M8, NUT, -40.0) is NUT


def test_neighbours_lose_a_few_per_cent_and_far_joints_nothing() -> None:
    stud_mm = GEOMETRY.pattern_mm("rotor")
    loss = interaction(M8, stud_mm)
    assert np.array_equal(loss, loss.T) and not np.diag(loss).any()
    assert 0.03 < loss[0, 1] < 0.1 and loss[0, 1] > loss[0, 2] > 0.0
    assert loss[0, 18] == 0.0


def test_the_shaft_slips_as_far_as_there_is_room_once_it_is_not_held() -> None:
    assert slip_deg(72.0, 400.0, 0.07) == 0.0
    assert slip_deg(72.0, 20.0, 0.07) == 0.07
    assert slip_deg(-72.0, 20.0, 0.07) == -0.07
    assert math.copysign(1.0, slip_deg(72.0, 20.0, 0.0)) == 1.0


def test_closing_a_gap_costs_what_resists_and_the_bow_of_the_flange() -> None:
    assert drawn_in_n(0.0, 500.0) == 0.0
    assert drawn_in_n(0.1, 500.0) == pytest.approx(2500.0)
