"""Intervals against published values."""

import pytest

from cellctl.studies.statistics import quantile, wilson


def test_interval_of_the_papers_26_of_30() -> None:
    low, high = wilson(26, 30)
    assert low == pytest.approx(0.703, abs=0.002)
    assert high == pytest.approx(0.947, abs=0.002)


def test_interval_holds_the_ends() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(50, 50)[1] == 1.0
    assert wilson(0, 50)[0] == 0.0


def test_nearest_rank_quantile() -> None:
    values = [float(v) for v in range(1, 101)]
    assert quantile(values, 0.95) == 95.0
    assert quantile([], 0.5) == 0.0
