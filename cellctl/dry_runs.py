"""Runs of an order on a private twin: one at a time, the newest results are kept."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import Literal

from cellctl.recipe import Recipe
from cellctl.session import Verdict
from cellctl.stamps import Stamps

KEEP = 100


@dataclass(frozen=True, slots=True)
class TwinOutcome:
    """What a run on a private twin came to. Phase times are cell time in seconds, in their order."""

    verdict: Verdict
    reasons: tuple[str, ...]
    cell_time_s: float
    phases_s: tuple[tuple[str, float], ...]


RunOnTwin = Callable[[Recipe, int], Awaitable[TwinOutcome]]
"""Runs a recipe on a private twin with the given seed."""


@dataclass(frozen=True, slots=True)
class DryRun:
    """One dry run; `outcome` is None until it has ended, `reason` says why it failed."""

    dry_run_id: str
    recipe: str
    recipe_version: int
    seed: int
    state: Literal["Running", "Ended", "Failed"]
    outcome: TwinOutcome | None = None
    reason: str = ""


class DryRuns:
    """The dry runs that were asked for."""

    def __init__(self, run_on_twin: RunOnTwin, stamps: Stamps) -> None:
        self._run_on_twin = run_on_twin
        self._stamps = stamps
        self._runs: dict[str, DryRun] = {}
        self._task: asyncio.Task[None] | None = None

    @property
    def busy(self) -> bool:
        """Whether one is running."""
        return self._task is not None and not self._task.done()

    def start(self, recipe: Recipe, seed: int) -> DryRun:
        """Begin one. The caller has seen that none is running."""
        header = recipe.recipe
        run = DryRun(self._stamps.new_id("dry"), header.id, header.version, seed, "Running")
        self._runs[run.dry_run_id] = run
        for old in list(self._runs)[:-KEEP]:
            del self._runs[old]
        self._task = asyncio.get_running_loop().create_task(self._work(run, recipe))
        return run

    def get(self, dry_run_id: str) -> DryRun | None:
        """One dry run."""
        return self._runs.get(dry_run_id)

    def all(self) -> list[DryRun]:
        """Newest first."""
        return list(reversed(self._runs.values()))

    async def close(self) -> None:
        """End what runs."""
        if self._task is not None and not self._task.done():
            self._task.cancel()
            await asyncio.wait({self._task})

    async def _work(self, run: DryRun, recipe: Recipe) -> None:
        try:
            outcome = await self._run_on_twin(recipe, run.seed)
        except Exception as error:
            self._runs[run.dry_run_id] = replace(run, state="Failed", reason=str(error))
        else:
            self._runs[run.dry_run_id] = replace(run, state="Ended", outcome=outcome)
