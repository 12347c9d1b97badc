"""Monte Carlo of docking: many seeds, each with a cell and parts of its own, and what came of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellctl.dock_runner import DockOutcome, DockRequest, Offset, dock_by_sight, dock_from, require_dockable
from cellctl.recipe import Recipe
from cellctl.studies.pool import map_in_processes
from cellctl.studies.statistics import quantile, wilson
from hal.config import CellConfig

DRAW = 0x646F636B
"""Tells the stream of the drawn errors apart from everything else that a seed feeds ("dock" in ASCII)."""


@dataclass(frozen=True, slots=True)
class PoseSigma:
    """Errors of the final pose, one sigma per axis; x and y are alike."""

    theta_deg: float
    xy_mm: float


@dataclass(frozen=True, slots=True)
class DockStudy:
    """What is asked: seeds `seed`, `seed` + 1, ... With `sigma` the pose is drawn, without it is found by sight."""

    recipe: Recipe
    config: CellConfig
    runs: int
    seed: int
    sigma: PoseSigma | None = None

    def seeds(self) -> range:
        """One per dock."""
        return range(self.seed, self.seed + self.runs)


@dataclass(frozen=True, slots=True)
class Dock:
    """One dock of a study; can be sent to another process."""

    request: DockRequest
    sigma: PoseSigma | None


def drawn(seed: int, sigma: PoseSigma) -> Offset:
    """One draw of theta, x, y. The same seed draws the same multiples of any sigma."""
    theta, x, y = np.random.default_rng((seed, DRAW)).standard_normal(3)
    return Offset(float(sigma.theta_deg * theta), float(sigma.xy_mm * x), float(sigma.xy_mm * y))


def dock(task: Dock) -> DockOutcome:
    """One dock. Depends on nothing but `task`."""
    if task.sigma is None:
        return dock_by_sight(task.request)
    return dock_from(task.request, drawn(task.request.seed, task.sigma))


def tasks(study: DockStudy) -> list[Dock]:
    """The docks of a study, by seed. Raises ConfigError where the twin cannot be built."""
    require_dockable(study.recipe, study.config)
    return [Dock(DockRequest(study.recipe, study.config, seed), study.sigma) for seed in study.seeds()]


def run_study(
    study: DockStudy, *, workers: int, on_dock: Callable[[DockOutcome], None] = lambda _: None
) -> tuple[DockOutcome, ...]:
    """All docks, by seed; the same for any number of workers. Raises ConfigError, WorkerError."""
    outcomes = []
    todo = tasks(study)
    for outcome in map_in_processes(dock, todo, workers=min(workers, len(todo)), modules=(__name__,)):
        on_dock(outcome)
        outcomes.append(outcome)
    return tuple(outcomes)


def summary(outcomes: Sequence[DockOutcome]) -> dict[str, Any]:
    """The statistics of `cellctl study dock --json`. Rates are of all runs; a refusal is no success of any kind."""
    runs = len(outcomes)
    succeeded = sum(outcome.succeeded for outcome in outcomes)
    document: dict[str, Any] = {
        "runs": runs,
        "succeeded": succeeded,
        "rate": succeeded / runs,
        "interval95": list(wilson(succeeded, runs)),
        "inserted_rate": sum(outcome.inserted for outcome in outcomes) / runs,
        "force_ok_rate": sum(outcome.force_ok for outcome in outcomes) / runs,
        "refused": sum(bool(outcome.refused) for outcome in outcomes),
        "peak_total_n": _extremes(outcome.peak_total_n for outcome in outcomes),
        "peak_bolt_n": _extremes(outcome.peak_bolt_n for outcome in outcomes),
        "failures": [{"seed": outcome.seed, "reason": outcome.reason} for outcome in outcomes if not outcome.succeeded],
    }
    aligned = [outcome for outcome in outcomes if outcome.forecast is not None]
    return document | ({"alignment": _alignment(aligned)} if aligned else {})


def _extremes(values: Iterable[float]) -> dict[str, float]:
    listed = list(values)
    return {"max": max(listed), "p95": quantile(listed, 0.95)}


def _alignment(aligned: Sequence[DockOutcome]) -> dict[str, Any]:
    """Errors of the pose at which the studs entered, errors of its estimate, and the sigmas that were believed."""
    pairs = [(one.offset, one.forecast) for one in aligned if one.forecast is not None]
    forecasts = [forecast for _, forecast in pairs]
    return {
        "docks": len(pairs),
        "theta_error_deg": _spread([at.theta_deg for at, _ in pairs]),
        "xy_error_mm": _spread([math.hypot(at.x_mm, at.y_mm) for at, _ in pairs]),
        "theta_estimate_error_deg": _spread([at.theta_deg + f.left.theta_deg for at, f in pairs]),
        "xy_estimate_error_mm": _spread([math.hypot(at.x_mm + f.left.x_mm, at.y_mm + f.left.y_mm) for at, f in pairs]),
        "sigma_theta_deg": _rms([forecast.sigma_theta_deg for forecast in forecasts]),
        "sigma_xy_mm": _rms([forecast.sigma_xy_mm for forecast in forecasts]),
        "p_insert": sum(forecast.p_insert for forecast in forecasts) / len(forecasts),
        "loops": {"max": max(f.loops for f in forecasts), "mean": sum(f.loops for f in forecasts) / len(forecasts)},
    }


def _spread(values: list[float]) -> dict[str, float]:
    return {"rms": _rms(values), "max": max(abs(value) for value in values)}


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values))
