"""The API on a small cell: a real store, a real order book, a run that writes two joints."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from fastapi import FastAPI

from cellctl.api.app import create_app
from cellctl.api.auth import DemoAuth
from cellctl.api.metrics import Metrics
from cellctl.api.services import Services
from cellctl.controller import Controller
from cellctl.dry_runs import DryRuns, TwinOutcome
from cellctl.event_log import EventLog
from cellctl.orders import Order, OrderBook, OrderRefused
from cellctl.ports import Checkpoint, Progress
from cellctl.recipe import Recipe
from cellctl.recipe_book import load_book
from cellctl.records.store import OpenRun, RunStore
from cellctl.records.summary import RunEnded, RunHeader
from cellctl.session import Outcome, RunEnd
from cellctl.stamps import VirtualStamps
from cellctl.states import Command, State
from hal.clock import run_virtual
from hal.jobs import InlineJobs
from tests.doubles import DoubleCell, DoubleSession, five_phases

ROOT = Path(__file__).parents[2]
TOKEN = "secret"
ORDER: dict[str, Any] = {
    "job_order_id": "JO-1",
    "recipe": "lpt_shaft_36",
    "recipe_version": 1,
    "serials": {"rotor": "R-1", "shaft": "S-1"},
}


class StoredSession(DoubleSession):
    """A run of five short phases with a journal of its own."""

    store: RunStore
    stamps: VirtualStamps
    order: Order
    recipe: Recipe
    opened: OpenRun | None = None

    async def prepare(self) -> None:
        await super().prepare()
        wanted = self.order.wanted
        header = RunHeader(
            self.run_id, wanted.job_order_id, self.recipe.model_dump(mode="json"), self.recipe.content_hash, "cell",
            "cal", "hash", wanted.rotor_serial, wanted.shaft_serial, "test",
        )  # fmt: skip
        self.opened = await self.store.begin(header, self.stamps)

    async def execute(self, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        assert self.opened is not None
        for index in range(2):
            joint = {"index": index, "gun": "a", "stage": "snug", "torque_nm": 10.0, "angle_deg": 30.0, "verdict": "ok"}
            await self.opened.ledger.note("joint", joint)
        return await super().execute(checkpoint, progress)

    async def close(self, end: RunEnd) -> None:
        await super().close(end)
        if self.opened is not None:
            await self.opened.end(RunEnded(end.ending.capitalize(), end.outcome.verdict, end.outcome.reasons))


@dataclass
class Api:
    """A client of the app, and what stands behind the app."""

    app: FastAPI
    services: Services
    client: httpx.AsyncClient
    cell: DoubleCell
    sessions: list[StoredSession]

    async def idle(self) -> None:
        """Bring the cell to Idle."""
        self.services.controller.request(Command.RESET)
        await self.services.controller.until(State.IDLE)


@asynccontextmanager
async def api(data: Path, *, role: str = "admin", wall_s: float = 1.0) -> AsyncIterator[Api]:
    """The API, signed in as `role`; everything is ended afterwards."""
    services, cell, sessions = services_on(data, wall_s)
    app = create_app(services)
    token = TOKEN if role == "admin" else f"{role}.{TOKEN}"
    headers = {"Authorization": f"Bearer {token}"} if role else {}
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://cell", headers=headers) as client:
        try:
            yield Api(app, services, client, cell, sessions)
        finally:
            services.events.close()
            await services.dry_runs.close()
            await services.controller.shutdown()


def services_on(data: Path, wall_s: float) -> tuple[Services, DoubleCell, list[StoredSession]]:
    """Services on a small cell; the list holds every session that was opened."""
    stamps = VirtualStamps(1)
    events = EventLog(stamps.now)
    cell = DoubleCell()
    controller = Controller(cell, events, safe_deadline_s=0.5)
    store = RunStore(data)
    book = load_book(ROOT / "recipes")
    sessions: list[StoredSession] = []

    def check(name: str, version: int) -> Recipe:
        recipe = book.get(name, version)
        if recipe is None:
            raise OrderRefused("recipe_unknown", "no recipe of that id and version")
        return recipe

    async def open_session(order: Order, recipe: Recipe) -> StoredSession:
        session = StoredSession(cell, five_phases, run_id=order.run_id, job_order_id=order.wanted.job_order_id)
        session.store, session.stamps, session.order, session.recipe = store, stamps, order, recipe
        sessions.append(session)
        return session

    async def on_twin(recipe: Recipe, seed: int) -> TwinOutcome:
        await asyncio.sleep(3.0)
        if seed == 13:
            raise RuntimeError("the twin was refused")
        return TwinOutcome("accepted", (), 2400.0, (("scan", 20.0),))

    orders = OrderBook(data / "orders.jsonl", controller, events, stamps, check=check, open_session=open_session)
    services = Services(
        cell_name="small-cell",
        controller=controller,
        orders=orders,
        events=events,
        recipes=book,
        runs=store,
        dry_runs=DryRuns(on_twin, stamps),
        auth=DemoAuth(TOKEN),
        metrics=Metrics(controller, events),
        not_ready=lambda: "",
        is_simulated=lambda: True,
        time_left_s=lambda snapshot: 60.0,
        jobs=InlineJobs(),
        wall_s=wall_s,
    )
    return services, cell, sessions


def run_api(data: Path, body: Callable[[Api], Awaitable[None]], *, role: str = "admin") -> None:
    """Run `body` on the API under virtual time."""

    async def main() -> None:
        async with api(data, role=role) as given:
            await body(given)

    run_virtual(main())
