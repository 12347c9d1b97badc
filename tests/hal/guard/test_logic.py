"""The guard's decision on single blocks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.guard.logic import Watch, check
from hal.interfaces import ForceBlock, GuardLimits

LIMITS = GuardLimits("insert", tare_n=980.0, trip_n=4.5, low_n=-50.0, stale_ms=50.0, block=10)


def block(net: list[float], *, sequence: int = 0, time_s: float = 0.0) -> ForceBlock:
    return ForceBlock(sequence, time_s, 0.001, np.array(net, dtype=np.float64) + LIMITS.tare_n)


def test_force_within_the_limits_passes_and_is_remembered() -> None:
    watch, trip = check(Watch(LIMITS), block([1.0, 3.0, 2.0], sequence=7), 0.004)
    assert trip is None
    assert (watch.peak_n, watch.last_n, watch.samples, watch.next_sequence) == pytest.approx((3.0, 2.0, 3, 10))
    watch, trip = check(watch, block([0.0, 1.0], sequence=10), 0.004)
    assert trip is None
    assert (watch.peak_n, watch.last_n, watch.samples) == pytest.approx((3.0, 1.0, 5))


@pytest.mark.parametrize(
    ("net", "reason", "force_n"),
    [
        ([1.0, 4.6, 9.0], "above 4.50 N", 4.6),
        ([1.0, -51.0], "below -50.00 N", -51.0),
        ([1.0, math.nan, 2.0], "not a number", math.nan),
        ([math.nan], "not a number", math.nan),
        ([math.inf], "above", math.inf),
        ([-math.inf], "below", -math.inf),
        ([], "no samples", math.nan),
    ],
)
def test_what_must_stop_the_axes(net: list[float], reason: str, force_n: float) -> None:
    _, trip = check(Watch(LIMITS), block(net), 0.004)
    assert trip is not None
    assert reason in trip.reason
    assert trip.reason.startswith("insert: ")
    assert trip.force_n == pytest.approx(force_n, nan_ok=True)


def test_the_limits_themselves_still_pass() -> None:
    assert check(Watch(LIMITS), block([4.5, -50.0]), 0.002)[1] is None


def test_missing_and_repeated_samples_trip() -> None:
    watch, _ = check(Watch(LIMITS), block([0.0, 0.0], sequence=5), 0.002)
    for sequence in (8, 5, 6):
        _, trip = check(watch, block([0.0], sequence=sequence), 0.002)
        assert trip is not None
        assert "sample 7 expected" in trip.reason


@pytest.mark.parametrize(("now", "trips"), [(0.051, False), (0.0525, True), (0.002, False), (-0.5, True), (1e9, True)])
def test_the_newest_sample_must_be_fresh(now: float, trips: bool) -> None:
    _, trip = check(Watch(LIMITS), block([0.0, 0.0, 0.0]), now)
    assert (trip is not None) == trips


def test_a_frozen_signal_trips_and_a_steady_one_with_noise_does_not() -> None:
    watch = Watch(LIMITS, frozen_samples=6)
    for sequence, net in ((0, [1.0, 2.0, 2.0, 2.0]), (4, [2.0, 2.0, 2.0]), (7, [2.0, 2.0])):
        watch, trip = check(watch, block(net, sequence=sequence), 0.004)
        assert trip is None
    assert watch.equal == 5
    _, trip = check(watch, block([2.0], sequence=9), 0.004)
    assert trip is not None
    assert "frozen at 2.00 N for 6 samples" in trip.reason
    moved, trip = check(watch, block([2.0, 2.001], sequence=9), 0.004)
    assert trip is None
    assert moved.equal == 0
    other, trip = check(watch, block([1.0, 1.0], sequence=9), 0.004)
    assert trip is None
    assert other.equal == 2
    assert check(Watch(LIMITS), block([0.0] * 1000), 1.0)[1] is None


def test_a_time_that_is_not_a_number_trips() -> None:
    assert check(Watch(LIMITS), block([0.0], time_s=math.nan), 0.0)[1] is not None


def test_peak_of_a_block_with_nan_counts_its_numbers() -> None:
    watch, _ = check(Watch(LIMITS), block([3.0, math.nan]), 0.0)
    assert watch.peak_n == pytest.approx(3.0)


samples = st.lists(st.floats(-1e4, 1e4) | st.just(math.nan), min_size=1, max_size=30)


@given(samples, st.floats(0.1, 1e3), st.floats(-1e3, -0.1))
def test_a_block_passes_exactly_when_every_sample_does(net: list[float], trip_n: float, low_n: float) -> None:
    limits = GuardLimits("p", tare_n=0.0, trip_n=trip_n, low_n=low_n, stale_ms=1e6, block=10)
    _, trip = check(Watch(limits), ForceBlock(0, 0.0, 0.001, np.array(net)), 1.0)
    assert (trip is None) == all(low_n <= value <= trip_n for value in net)
