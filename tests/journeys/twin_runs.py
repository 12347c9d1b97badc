"""Whole assemblies for tests: the same physics with fewer bolts and pixels, clouds and measurements remembered."""

from __future__ import annotations

import asyncio
import hashlib
import pickle
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from cellctl.recipe import Recipe, load_recipe
from cellctl.runner import Outcome, RunRequest, run_once, with_twin
from hal.config import CellConfig, Level, load_cell
from hal.fake.fault_file import Fault

ROOT = Path(__file__).parents[2]
RECIPE = ROOT / "recipes" / "lpt_shaft_36.toml"
CELL = ROOT / "deploy" / "cell.fake.toml"
FAULTS = ROOT / "recipes" / "faults"
SMALL = 8
"""Joints of the small recipe: opposite pairs, a star order, both guns, and a quarter of the time."""
POINTS = 120_000
FINE_CAMERA = {"scanner_noise_mm": 0.005, "scanner_ripple_mm": 0.002}
"""Few pixels see as much as many do through the usual camera."""
T = TypeVar("T")


class RememberedJobs:
    """`hal.jobs.Jobs` that computes each cloud and each measurement once: same function, same arguments, same result.

    Runs of one seed see the same scenes until something makes them differ, so most of them need no camera at all.
    """

    def __init__(self) -> None:
        self._known: dict[bytes, tuple[Any, Exception | None]] = {}
        self.computed = 0

    async def run(self, func: Callable[..., T], *args: Any, latency_s: float) -> T:
        """See `hal.jobs.Jobs.run`."""
        key = hashlib.blake2b(pickle.dumps((func, args), protocol=5), digest_size=16).digest()
        if key not in self._known:
            self.computed += 1
            try:
                self._known[key] = func(*args), None
            except Exception as error:
                self._known[key] = None, error
        result, error = self._known[key]
        await asyncio.sleep(latency_s)
        if error is not None:
            raise error
        return result  # type: ignore[no-any-return]


@cache
def small_recipe(count: int = SMALL) -> Recipe:
    """The 36-joint recipe with fewer joints on the same circle."""
    whole = load_recipe(RECIPE)
    return whole.model_copy(update={"pattern": whole.pattern.model_copy(update={"count": count})})


def twin_cell(
    overrides: Mapping[str, float] | None = None, *, level: Level = "nominal", points: int = POINTS
) -> CellConfig:
    """The cell on fake devices with that twin behind a fine camera."""
    return with_twin(load_cell(CELL), level=level, points=points, overrides={**FINE_CAMERA, **(overrides or {})})


def assembled(
    recipe: Recipe,
    config: CellConfig,
    *,
    seed: int = 1,
    faults: Iterable[Fault] = (),
    forced: tuple[str, ...] = (),
    jobs: RememberedJobs | None = None,
) -> Outcome:
    """One run to its end, its record thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        return run_once(
            RunRequest(recipe, config, seed, Path(folder), tuple(faults), forced, "none", jobs=jobs or RememberedJobs())
        )


def told(outcome: Outcome) -> str:
    """One line about a run, for a failing test."""
    truth = "good" if outcome.truth.good else "; ".join(outcome.truth.reasons)
    return f"{outcome.state}, {outcome.verdict}: {'; '.join(outcome.reasons)} (truth: {truth})"
