"""Dry runs: an order tried on a private twin."""

from __future__ import annotations

import secrets
from typing import Annotated

from fastapi import APIRouter, Depends

from cellctl.api.auth import Allow, Role
from cellctl.api.problems import ProblemError
from cellctl.api.schemas import DryRun, DryRunRequest, DryRuns
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.dry_runs import DryRun as Tried

router = APIRouter(route_class=StrictRoute, tags=["dry runs"])


@router.post("/dry-runs", status_code=202, dependencies=[Depends(Allow(Role.OPERATOR, Role.MES))])
async def start(asked: DryRunRequest, services: Annotated[Services, Depends(services_of)]) -> DryRun:
    """Begin a dry run; one at a time."""
    recipe = services.recipes.get(asked.recipe, asked.recipe_version)
    if recipe is None:
        raise ProblemError(422, "recipe_unknown", "no recipe of that id and version")
    if services.dry_runs.busy:
        raise ProblemError(409, "dry_run_busy", "a dry run is running; ask again when it has ended")
    seed = secrets.randbelow(2**31) if asked.seed is None else asked.seed
    return _told(services.dry_runs.start(recipe, seed))


@router.get("/dry-runs", dependencies=[Depends(Allow(Role.VIEWER))])
async def all_dry_runs(services: Annotated[Services, Depends(services_of)]) -> DryRuns:
    """The newest dry runs, newest first."""
    return DryRuns(items=[_told(run) for run in services.dry_runs.all()])


@router.get("/dry-runs/{dry_run_id}", dependencies=[Depends(Allow(Role.VIEWER))])
async def one_dry_run(dry_run_id: str, services: Annotated[Services, Depends(services_of)]) -> DryRun:
    """One dry run and what it came to."""
    run = services.dry_runs.get(dry_run_id)
    if run is None:
        raise ProblemError(404, "dry_run_unknown", "no dry run of that id")
    return _told(run)


def _told(run: Tried) -> DryRun:
    outcome = run.outcome
    return DryRun(
        dry_run_id=run.dry_run_id,
        recipe=run.recipe,
        recipe_version=run.recipe_version,
        seed=run.seed,
        state=run.state,
        verdict=outcome.verdict if outcome else None,
        reasons=list(outcome.reasons) if outcome else [run.reason] if run.reason else [],
        cell_time_s=outcome.cell_time_s if outcome else None,
    )
