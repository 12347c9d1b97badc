"""What the guard process decides, and in which order it acts. No loop, no clock: each call says what time it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.codec.cia301 import RPDO1
from hal.codec.lawicel import CanFrame
from hal.guard.sentry import Sentry
from hal.interfaces import ForceBlock, GuardLimits

LIMITS = GuardLimits("insert", tare_n=1000.0, trip_n=5.0, low_n=-50.0, stale_ms=5.0, block=10)
ENABLE, QUICK_STOP = CanFrame(RPDO1 + 3, b"\x0f\x00\x01"), CanFrame(RPDO1 + 3, b"\x02\x00\x01")
PERIOD_S = 0.001


class Guarded:
    """A sentry that is cleared at time 0, what it did, and samples by time."""

    def __init__(self, *, cleared: bool = True) -> None:
        self.did: list[str] = []
        self.sentry = Sentry(
            lambda: self.did.append("stop" if self.sentry.gate.latched else "stop before the gate was latched"),
            lambda: self.did.append("tell"),
            beat_s=0.1,
            quiet_s=0.5,
            consumer_s=0.2,
        )
        self.sentry.beat(0.0)
        self.sentry.heartbeat_sent(0.0)
        if cleared:
            assert self.sentry.clear(self.sentry.gate.epoch, 0.0) == ""
            self.did.clear()

    def samples(self, now: float, *forces_n: float, age_s: float = 0.0) -> None:
        """The last of them taken `age_s` ago."""
        first = round((now - age_s) / PERIOD_S) - len(forces_n) + 1
        self.sentry.samples(ForceBlock(first, first * PERIOD_S, PERIOD_S, np.array(forces_n)), now)

    @property
    def reason(self) -> str:
        return self.sentry.state(0.0).reason


def test_it_starts_latched_and_is_cleared_by_the_trips_number() -> None:
    guarded = Guarded(cleared=False)
    assert "not re-armed" in guarded.reason
    assert not guarded.sentry.passes(ENABLE, guarded.sentry.gate.epoch, 0.0)
    assert "tripped again" in guarded.sentry.clear(guarded.sentry.gate.epoch - 1, 0.0)
    assert guarded.sentry.clear(guarded.sentry.gate.epoch, 0.0) == ""
    assert guarded.sentry.passes(ENABLE, guarded.sentry.gate.epoch, 0.0)


def test_it_is_not_cleared_while_the_drives_hear_nothing() -> None:
    guarded = Guarded(cleared=False)
    assert "heartbeat" in guarded.sentry.clear(guarded.sentry.gate.epoch, 0.3)


@pytest.mark.parametrize(("force_n", "why"), [(1006.0, "above 5.00"), (900.0, "below -50"), (math.nan, "not a number")])
def test_one_sample_outside_stops_the_drives_before_anybody_is_told(force_n: float, why: str) -> None:
    guarded = Guarded()
    guarded.sentry.arm(LIMITS, 0.010)
    guarded.samples(0.011, 1001.0)
    assert guarded.sentry.proven
    guarded.did.clear()
    guarded.samples(0.012, force_n)
    assert guarded.did == ["stop", "tell"]
    assert why in guarded.reason
    assert not guarded.sentry.armed
    assert not guarded.sentry.passes(ENABLE, guarded.sentry.gate.epoch, 0.012)
    assert guarded.sentry.passes(QUICK_STOP, 0, 0.012)
    guarded.samples(0.013, 5000.0)
    assert guarded.did == ["stop", "tell"], "the first trip stays"


def test_unarmed_no_force_trips() -> None:
    guarded = Guarded()
    guarded.samples(0.001, 5000.0)
    guarded.sentry.look(0.15)
    assert guarded.reason == ""


def test_samples_from_before_it_was_armed_are_let_go_but_not_waited_out() -> None:
    guarded = Guarded()
    guarded.sentry.arm(LIMITS, 0.010)
    guarded.samples(0.011, 5000.0, 5000.0, age_s=0.003)
    assert guarded.reason == ""
    assert not guarded.sentry.proven
    guarded.sentry.look(0.0151)
    assert "silent for 5.1 ms (limit 5 ms)" in guarded.reason


def test_missing_and_old_samples_trip() -> None:
    guarded = Guarded()
    guarded.sentry.arm(LIMITS, 0.010)
    guarded.samples(0.011, 1001.0)
    guarded.samples(0.013, 1001.0)
    assert "the force sensor's samples have a gap: sample 12 expected, 13 came" in guarded.reason
    guarded = Guarded()
    guarded.sentry.arm(LIMITS, 0.0)
    guarded.samples(0.012, 1001.0, age_s=0.006)
    assert "6.0 ms old" in guarded.reason


def test_it_is_due_when_sample_or_beat_is_overdue() -> None:
    guarded = Guarded()
    assert guarded.sentry.due_s() == math.inf
    guarded.sentry.arm(LIMITS, 0.010)
    assert guarded.sentry.due_s() == pytest.approx(0.015)
    for sample in range(11, 98):
        guarded.samples(sample * PERIOD_S, 1001.0)
    assert guarded.sentry.due_s() == pytest.approx(0.100)
    guarded.sentry.look(0.1)
    assert guarded.reason == "", "on the limit"


def test_while_armed_a_controller_that_is_not_heard_is_dead_after_100_ms() -> None:
    guarded = Guarded()
    guarded.sentry.arm(LIMITS, 0.099)
    guarded.samples(0.1, 1001.0)
    guarded.sentry.look(0.1011)
    assert "controller is not heard for 101 ms (limit 100 ms)" in guarded.reason
    assert guarded.did[-2:] == ["stop", "tell"]


def test_at_other_times_the_drives_heartbeat_is_withheld_and_the_gate_latched_before_they_act_on_it() -> None:
    guarded = Guarded()
    sentry, epoch = guarded.sentry, guarded.sentry.gate.epoch
    for now in np.arange(0.05, 0.501, 0.05):
        assert sentry.heartbeat_due(float(now))
        sentry.heartbeat_sent(float(now))
    assert not sentry.heartbeat_due(0.55)
    assert sentry.passes(ENABLE, epoch, 0.69)
    assert not sentry.passes(ENABLE, epoch, 0.71), "the drives stop by themselves by now"
    assert "no heartbeat" in guarded.reason


def test_a_guard_that_stood_still_lets_nothing_pass_that_waited_meanwhile() -> None:
    guarded = Guarded()
    assert not guarded.sentry.passes(ENABLE, guarded.sentry.gate.epoch, 3.0)
    assert guarded.did == ["stop", "tell"]


def test_a_controller_that_is_gone_is_a_trip() -> None:
    guarded = Guarded()
    guarded.sentry.gone()
    assert "connection ended" in guarded.reason
    assert not guarded.sentry.heartbeat_due(0.01)
    guarded.sentry.arm(LIMITS, 0.01)
    assert not guarded.sentry.armed, "a trip is latched"
