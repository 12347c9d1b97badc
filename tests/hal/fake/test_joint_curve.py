"""Torque over rotation of sound and unsound nuts."""

from dataclasses import replace

import numpy as np
import pytest

from hal.fake.geometry import JointGeometry
from hal.fake.joints.curve import Condition, Curve, free_spin, loosening, tightening
from hal.fake.joints.joint import NutState, elastic_n_per_deg, properties_of, torque_per_n_mm

M8 = properties_of(JointGeometry(angles_deg=tuple(10.0 * i for i in range(36))))
STARTED = NutState(present=True, climb_mm=2.0)
TIGHT = NutState(present=True, climb_mm=M8.travel_mm, preload_n=20_000.0)
SOUND = Condition()


def rotation_at(curve: Curve, preload_n: float) -> float:
    return float(np.interp(preload_n, curve.preload_n, curve.rotation_deg))


@pytest.mark.parametrize("nut", [STARTED, TIGHT, replace(STARTED, crossed=True), replace(STARTED, stripped=True)])
def test_rotation_never_goes_back(nut: NutState) -> None:
    for curve in (tightening(M8, nut, SOUND), loosening(M8, nut, SOUND)):
        assert (np.diff(curve.rotation_deg) >= 0.0).all()
        assert len(curve.rotation_deg) == len(curve.torque_nm) == len(curve.preload_n)


def test_run_down_then_seat_then_preload() -> None:
    curve = tightening(M8, STARTED, SOUND)
    seat_deg = (M8.travel_mm - 2.0) * 360.0
    torque, preload = curve.at(seat_deg - 10.0)
    assert preload == 0.0 and torque == pytest.approx(M8.prevailing_nm)
    torque, preload = curve.at(seat_deg + 40.0)
    assert torque == pytest.approx(M8.prevailing_nm + 1e-3 * torque_per_n_mm(M8, STARTED) * preload, rel=0.01)
    assert preload == pytest.approx(36.0 * elastic_n_per_deg(M8), rel=0.01)


def test_a_tight_nut_breaks_away_before_it_turns() -> None:
    curve = tightening(M8, TIGHT, SOUND)
    lever = 1e-3 * torque_per_n_mm(M8, TIGHT)
    assert curve.torque_nm[:2].max() == pytest.approx(M8.prevailing_nm + 1.04 * lever * 20_000.0)
    assert curve.preload_n[0] == 20_000.0 and curve.rotation_deg[1] == 0.0


def test_beyond_yield_torque_hardly_rises() -> None:
    curve = tightening(M8, STARTED, SOUND)
    at_yield = rotation_at(curve, M8.yield_n)
    before = curve.at(at_yield)[0] - curve.at(at_yield - 10.0)[0]
    after = curve.at(at_yield + 10.0)[0] - curve.at(at_yield)[0]
    assert 0.0 < after < 0.05 * before


def test_a_stripped_thread_never_reaches_the_final_torque() -> None:
    curve = tightening(M8, replace(STARTED, stripped=True), SOUND)
    assert curve.torque_nm.max() < 15.0 and curve.torque_nm[-1] < 4.0


def test_a_nut_askew_jams_within_half_a_turn_and_clamps_nothing() -> None:
    torque, preload = tightening(M8, replace(STARTED, crossed=True), SOUND).at(180.0)
    assert torque > 6.0 and preload < 500.0


def test_an_open_gap_is_drawn_in_against_what_resists() -> None:
    closed, gap = tightening(M8, STARTED, SOUND), tightening(M8, STARTED, Condition(gap_mm=0.2, resistance_n=300.0))
    # The flange hangs lower by the gap, and the nut pulls it up over the same way.
    assert rotation_at(gap, 15_000.0) - rotation_at(closed, 15_000.0) < 0.0
    seat_deg = (M8.travel_mm - 2.0 - 0.2) * 360.0
    assert gap.at(seat_deg + 72.0)[1] == pytest.approx(300.0 + 20_000.0 * 0.2, rel=1e-6)


def test_more_friction_gives_less_preload_at_the_same_torque() -> None:
    plain, rough = tightening(M8, STARTED, SOUND), tightening(M8, STARTED, Condition(friction=1.2))
    at = [float(np.interp(30.0, curve.torque_nm, curve.preload_n)) for curve in (plain, rough)]
    assert at[1] < 0.9 * at[0]


def test_loosening_goes_to_zero_and_takes_the_nut_off() -> None:
    curve = loosening(M8, TIGHT, SOUND)
    assert curve.preload_n[0] == 20_000.0 and curve.preload_n[-1] == 0.0
    assert curve.torque_nm.max() < tightening(M8, TIGHT, SOUND).torque_nm[:2].max()
    assert curve.torque_nm[-1] == M8.free_torque_nm


def test_an_empty_socket_meets_nothing() -> None:
    assert free_spin(M8).torque_nm.max() < 0.1
