"""CPU of one whole run without its camera, of one render and of one measurement, as ratios to the sum pass."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np

from cellctl.recipe import load_recipe
from cellctl.runner import with_twin
from hal.config import load_cell
from tests.journeys.twin_runs import CELL, RECIPE, RememberedJobs, assembled, told

T = TypeVar("T")
POINTS = 500_000
SEED = 3


class ListedJobs(RememberedJobs):
    """Remembers results, and the first call of each function, by the function's name."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: dict[str, Callable[[], Any]] = {}

    async def run(self, func: Callable[..., T], *args: Any, latency_s: float) -> T:
        """See `hal.jobs.Jobs.run`."""
        name = getattr(func, "func", func).__name__
        self.calls.setdefault(name, lambda: func(*args))
        return await super().run(func, *args, latency_s=latency_s)


def cpu_s(do: Callable[[], object], times: int) -> float:
    """Median CPU seconds of `do`, of all threads together."""
    taken = []
    for _ in range(times):
        begin = time.process_time()
        do()
        taken.append(time.process_time() - begin)
    return median(taken)


def whole_run(work: Path) -> dict[str, Any]:
    """Sum passes over POINTS points that each takes. Raises SystemExit where the seed is no nominal run."""
    recipe, jobs = load_recipe(RECIPE), ListedJobs()
    config = with_twin(load_cell(CELL), points=POINTS)

    def run() -> None:
        outcome = assembled(recipe, config, seed=SEED, jobs=jobs)
        if outcome.verdict != "accepted":
            raise SystemExit(f"seed {SEED} is not a nominal run: {told(outcome)}")

    run()  # from now on the clouds and measurements of this seed are known
    points = np.random.default_rng(SEED).normal(size=(POINTS, 3)).astype(np.float32)
    unit_s = cpu_s(lambda: points.astype(np.float64).sum(axis=0), 15)
    rows = {
        name: {"seconds": seconds, "passes": seconds / unit_s}
        for name, seconds in (
            ("whole run without camera", cpu_s(run, 3)),
            ("one render", cpu_s(jobs.calls["render"], 3)),
            ("one measurement", cpu_s(jobs.calls["measure_part"], 3)),
        )
    }
    return {"seed": SEED, "points": POINTS, "unit_s": unit_s, "rows": rows}
