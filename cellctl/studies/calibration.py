"""Whether stated uncertainties are true: normalised errors of poses, reliability of probabilities. Pure statistics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

LEAST_ODDS = 1e-4
"""Probabilities are kept so far from 0 and 1 where their logarithm is taken: a simulation knows them no better."""
DECILES = 10


def nees(errors: Array, covariances: Array) -> Array:
    """(m,) normalised error squared per degree of freedom of errors (m, k) with covariances (m, k, k); 1 expected."""
    solved = np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]
    return np.asarray(np.sum(errors * solved, axis=1) / errors.shape[1])


def mean_interval(values: Array, generator: np.random.Generator, *, level: float = 0.95) -> tuple[float, float]:
    """Interval of the mean of values (m,) by bootstrap (percentile, 2,000 resamples)."""
    means = values[generator.integers(0, len(values), (2000, len(values)))].mean(axis=1)
    low, high = np.quantile(means, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)


def clopper_pearson(successes: int, runs: int, *, level: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval of a rate (Clopper, Pearson, Biometrika 26 (1934) 404)."""
    tail = 0.5 * (1.0 - level)
    low = float(stats.beta.ppf(tail, successes, runs - successes + 1)) if successes else 0.0
    high = float(stats.beta.ppf(1.0 - tail, successes + 1, runs - successes)) if successes < runs else 1.0
    return low, high


@dataclass(frozen=True, slots=True)
class Decile:
    """A tenth of the cases, by prediction: their mean prediction, how many succeeded, the interval of that rate."""

    predicted: float
    runs: int
    successes: int
    low: float
    high: float

    @property
    def holds(self) -> bool:
        """Whether the interval holds the prediction."""
        return self.low <= self.predicted <= self.high


@dataclass(frozen=True, slots=True)
class Reliability:
    """How predicted probabilities and outcomes agree.

    `slope` and `intercept` of the outcome's log odds over the predicted ones (Cox, Biometrika 45 (1958) 562; 1 and 0
    expected) with one standard error each; `linear_slope` of the outcome over the prediction. `skill` is 1 minus the
    Brier score over that of the base rate.
    """

    runs: int
    base_rate: float
    mean_predicted: float
    slope: float
    sigma_slope: float
    intercept: float
    sigma_intercept: float
    linear_slope: float
    brier: float
    skill: float
    deciles: tuple[Decile, ...]


def reliability(predicted: Array, succeeded: NDArray[np.bool_], *, level: float = 0.95) -> Reliability:
    """Of predictions (m,) against outcomes (m,); `level` is that of each decile's interval."""
    outcome = succeeded.astype(np.float64)
    (intercept, slope), (sigma_intercept, sigma_slope) = _logistic(predicted, outcome)
    base = float(outcome.mean())
    brier = float(np.mean((predicted - outcome) ** 2))
    return Reliability(
        runs=len(outcome),
        base_rate=base,
        mean_predicted=float(predicted.mean()),
        slope=slope,
        sigma_slope=sigma_slope,
        intercept=intercept,
        sigma_intercept=sigma_intercept,
        linear_slope=float(np.polyfit(predicted, outcome, 1)[0]),
        brier=brier,
        skill=1.0 - brier / max(base * (1.0 - base), 1e-12),
        deciles=_deciles(predicted, outcome, level),
    )


def _logistic(predicted: Array, outcome: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Intercept and slope of the log odds by Newton's method, and their standard errors."""
    p = np.clip(predicted, LEAST_ODDS, 1.0 - LEAST_ODDS)
    design = np.column_stack([np.ones(len(p)), np.log(p / (1.0 - p))])
    beta, normal = np.array([0.0, 1.0]), np.eye(2)
    for _ in range(50):
        mean = 1.0 / (1.0 + np.exp(-design @ beta))
        normal = (design * (mean * (1.0 - mean))[:, None]).T @ design + 1e-9 * np.eye(2)
        step = np.linalg.solve(normal, design.T @ (outcome - mean))
        beta = beta + np.clip(step, -1.0, 1.0)
        if np.abs(step).max() < 1e-10:
            break
    errors = np.sqrt(np.diag(np.linalg.inv(normal)))
    return (float(beta[0]), float(beta[1])), (float(errors[0]), float(errors[1]))


def _deciles(predicted: Array, outcome: Array, level: float) -> tuple[Decile, ...]:
    groups = np.array_split(np.argsort(predicted, kind="stable"), DECILES)
    found = []
    for group in groups:
        runs, successes = len(group), int(outcome[group].sum())
        low, high = clopper_pearson(successes, runs, level=level)
        found.append(Decile(float(predicted[group].mean()), runs, successes, low, high))
    return tuple(found)
