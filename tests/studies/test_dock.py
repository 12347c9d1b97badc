"""Monte Carlo of docking: draws, rates, and what counts as a success."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from cellctl.dock_runner import DockOutcome, Forecast, Offset
from cellctl.studies.dock import DockStudy, PoseSigma, dock, drawn, run_study, summary, tasks
from tests.test_dock_runner import RECIPE, cell

PAPER = PoseSigma(0.035, 0.025)


@functools.cache
def outcomes(runs: int, sigma: PoseSigma, stiffness_n_per_mm: float = 1000.0) -> tuple[DockOutcome, ...]:
    config = cell(lateral_stiffness_n_per_mm=stiffness_n_per_mm)
    return tuple(dock(task) for task in tasks(DockStudy(RECIPE, config, runs, 1, sigma)))


def outcome(
    seed: int, *, inserted: bool = True, first: bool = True, peak_n: float = 0.0, refused: str = ""
) -> DockOutcome:
    return DockOutcome(
        seed=seed,
        inserted=inserted,
        force_ok=inserted and peak_n <= 10.0,
        first_attempt=first,
        peak_total_n=2.0 * peak_n,
        peak_bolt_n=peak_n,
        offset=Offset(0.003, 0.003, -0.004),
        reason="why" if refused or not (inserted and first) or peak_n > 10.0 else "",
        refused=refused,
        forecast=None if refused else Forecast(Offset(-0.001, 0.009, 0.009), 0.004, 0.02, 0.999, 1),
    )


def test_a_seed_draws_the_same_multiples_of_any_sigma() -> None:
    small, large = drawn(5, PAPER), drawn(5, PoseSigma(0.07, 0.075))
    assert large.theta_deg == pytest.approx(2.0 * small.theta_deg)
    assert (large.x_mm, large.y_mm) == pytest.approx((3.0 * small.x_mm, 3.0 * small.y_mm))
    assert drawn(6, PAPER) != small


def test_draws_have_the_asked_scatter() -> None:
    draws = np.array([(d.theta_deg, d.x_mm, d.y_mm) for d in (drawn(seed, PAPER) for seed in range(4000))])
    assert draws.std(axis=0) == pytest.approx((0.035, 0.025, 0.025), rel=0.05)
    assert np.abs(draws.mean(axis=0) / draws.std(axis=0)).max() < 0.06
    assert np.abs(np.corrcoef(draws.T) - np.eye(3)).max() < 0.06


def test_errors_of_the_papers_size_are_mostly_below_the_limit() -> None:
    result = summary(outcomes(40, PAPER))
    assert result["inserted_rate"] == 1.0
    assert 0.7 <= result["force_ok_rate"] < 1.0


def test_without_error_every_dock_succeeds() -> None:
    result = summary(outcomes(10, PoseSigma(0.0, 0.0)))
    assert (result["succeeded"], result["failures"]) == (10, [])


def test_wide_errors_rarely_succeed() -> None:
    assert summary(outcomes(20, PoseSigma(0.2, 0.025)))["force_ok_rate"] < 0.5


def test_the_same_errors_cost_more_with_a_stiffer_chuck() -> None:
    soft, middle, hard = (outcomes(20, PAPER, stiffness) for stiffness in (200.0, 1000.0, 10_000.0))
    peaks = np.array([[dock.peak_bolt_n for dock in docks] for docks in (soft, middle, hard)])
    touched = peaks[0] > 0.0
    assert touched.any()
    assert (np.diff(peaks[:, touched], axis=0) > 0.0).all()
    assert summary(soft)["force_ok_rate"] > summary(hard)["force_ok_rate"]


def test_the_number_of_workers_changes_nothing() -> None:
    study = DockStudy(RECIPE, cell(), 3, 11, PoseSigma(0.2, 0.025))
    seen: list[DockOutcome] = []
    apart = run_study(study, workers=2, on_dock=seen.append)
    assert apart == tuple(dock(task) for task in tasks(study))
    assert [one.seed for one in apart] == [11, 12, 13]
    assert seen == list(apart)


def test_a_success_is_in_below_the_limit_and_at_the_first_attempt() -> None:
    result = summary(
        (
            outcome(1),
            outcome(2, peak_n=9.0),
            outcome(3, peak_n=12.0),
            outcome(4, first=False),
            outcome(5, inserted=False, peak_n=4000.0),
            outcome(6, inserted=False, refused="features_missing"),
        )
    )
    assert (result["runs"], result["succeeded"], result["refused"]) == (6, 2, 1)
    assert result["rate"] == pytest.approx(2 / 6)
    assert result["interval95"][0] < 2 / 6 < result["interval95"][1]
    assert result["inserted_rate"] == pytest.approx(4 / 6)
    assert result["force_ok_rate"] == pytest.approx(3 / 6)
    assert result["peak_bolt_n"]["max"] == 4000.0
    assert result["peak_total_n"]["max"] == 8000.0
    assert [failure["seed"] for failure in result["failures"]] == [3, 4, 5, 6]


def test_errors_by_sight_stand_beside_what_was_believed() -> None:
    result = summary((outcome(1), outcome(2, inserted=False, refused="too_noisy")))["alignment"]
    assert result["docks"] == 1
    assert result["xy_error_mm"]["rms"] == pytest.approx(0.005)
    assert result["theta_error_deg"]["max"] == pytest.approx(0.003)
    assert result["theta_estimate_error_deg"]["rms"] == pytest.approx(0.002)
    assert result["xy_estimate_error_mm"]["max"] == pytest.approx(0.013)
    assert result["sigma_theta_deg"] == pytest.approx(0.004)
