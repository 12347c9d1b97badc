"""Statistics of calibration against cases whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.studies.calibration import clopper_pearson, mean_interval, nees, reliability


def test_normalised_errors_of_what_the_covariance_says_average_one() -> None:
    rng = np.random.default_rng(1)
    root = np.array([[0.02, 0.0, 0.0], [0.01, 0.015, 0.0], [0.001, -0.002, 0.004]])
    errors = rng.normal(size=(4000, 3)) @ root.T
    ratio = nees(errors, np.tile(root @ root.T, (4000, 1, 1)))
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
    low, high = mean_interval(ratio, rng)
    assert low < 1.0 < high
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(2 / 3 / 4000), rel=0.15)


def test_half_the_sigma_makes_four_times_the_ratio() -> None:
    errors = np.array([[0.01, 0.0], [0.0, 0.02]])
    assert nees(errors, np.tile(np.diag([1e-4, 4e-4]), (2, 1, 1))) == pytest.approx([0.5, 0.5])
    assert nees(errors, np.tile(np.diag([2.5e-5, 1e-4]), (2, 1, 1))) == pytest.approx([2.0, 2.0])


def test_exact_interval_of_a_rate() -> None:
    assert clopper_pearson(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)  # 1 - 0.025^(1/10)
    assert clopper_pearson(10, 10) == pytest.approx((0.6915, 1.0), abs=1e-4)
    assert clopper_pearson(26, 30) == pytest.approx((0.6928, 0.9624), abs=1e-4)  # the paper's 26 of 30


def test_true_odds_are_reliable() -> None:
    rng = np.random.default_rng(2)
    p = rng.uniform(0.0, 1.0, 20_000)
    found = reliability(p, rng.random(20_000) < p, level=0.999)
    assert found.slope == pytest.approx(1.0, abs=4 * found.sigma_slope)
    assert found.intercept == pytest.approx(0.0, abs=4 * found.sigma_intercept)
    assert found.linear_slope == pytest.approx(1.0, abs=0.05)
    assert found.skill == pytest.approx(1 / 3, abs=0.03)  # of odds that are spread evenly
    assert all(decile.holds for decile in found.deciles)
    assert sum(decile.runs for decile in found.deciles) == found.runs == 20_000


def test_odds_that_are_too_sure_show_in_the_slope_and_in_the_tenths() -> None:
    rng = np.random.default_rng(3)
    p = rng.uniform(0.02, 0.98, 5000)
    log_odds = np.log(p / (1 - p))
    found = reliability(1 / (1 + np.exp(-2.0 * log_odds)), rng.random(5000) < p)
    assert found.slope == pytest.approx(0.5, abs=0.05)
    assert sum(decile.holds for decile in found.deciles) < 6


def test_the_base_rate_has_no_skill() -> None:
    outcome = np.arange(100) % 4 == 0
    assert reliability(np.full(100, 0.25) + np.linspace(0, 1e-9, 100), outcome).skill == pytest.approx(0.0, abs=1e-6)
