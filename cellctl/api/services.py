"""What the routes are given by the composition root."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fastapi import Request

from cellctl.api.auth import Authenticator
from cellctl.api.metrics import Metrics
from cellctl.controller import Controller, Snapshot
from cellctl.dry_runs import DryRuns
from cellctl.event_log import EventLog
from cellctl.orders import OrderBook
from cellctl.recipe_book import RecipeBook
from cellctl.records.store import RunStore
from hal.jobs import Jobs


@dataclass(frozen=True, slots=True)
class Services:
    """Everything behind the API. `wall_s` is how many seconds of the loop's time one second of the wall lasts.

    `not_ready` says in one sentence why no order can be worked on, or is empty; `is_simulated` whether any device
    is or may be a simulation. `time_left_s` estimates the rest of
    the run in cell time, None where nothing is known. `jobs` run what is heavy and no part of what the cell does.
    """

    cell_name: str
    controller: Controller
    orders: OrderBook
    events: EventLog
    recipes: RecipeBook
    runs: RunStore
    dry_runs: DryRuns
    auth: Authenticator
    metrics: Metrics
    not_ready: Callable[[], str]
    is_simulated: Callable[[], bool]
    time_left_s: Callable[[Snapshot], float | None]
    jobs: Jobs
    wall_s: float = 1.0

    @property
    def simulated(self) -> bool:
        """Whether what is done here may be done by a simulation."""
        return self.is_simulated()


async def services_of(request: Request) -> Services:
    """The services of the app that handles `request`."""
    services: Services = request.app.state.services
    return services
