"""Composition root of the service: cell file in, a running API out.

Everything lives in one event loop whose clock may be quickened; heavy work is done in worker processes.
"""

from __future__ import annotations

import asyncio
import dataclasses
import gc
import logging
import os
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import httpx
from fastapi import FastAPI
from fastapi.responses import StreamingResponse

from cellctl.api.app import create_app
from cellctl.api.auth import Allow, Authenticator, DemoAuth, declared
from cellctl.api.keys import KeyAuth
from cellctl.api.metrics import Metrics
from cellctl.api.server import Server, bound, make_server
from cellctl.api.services import Services
from cellctl.controller import Controller, Snapshot
from cellctl.dry_runs import DryRuns, TwinOutcome
from cellctl.event_log import EventLog
from cellctl.orders import Fault, Order, OrderBook, OrderRefused
from cellctl.recipe import Recipe
from cellctl.recipe_book import RecipeBook, load_book
from cellctl.records.errors import RecordError, UnknownRun
from cellctl.records.store import RunStore
from cellctl.records.summary import RunEnded
from cellctl.safety_watch import watch_safety
from cellctl.service_rules import Settings, real_devices, refuse_unfit
from cellctl.session import SafeCell, Session
from cellctl.signals import ending
from cellctl.stamps import Stamps, WallStamps
from cellctl.states import Command
from hal.config import CellConfig, load_cell
from hal.errors import ConfigError
from hal.jobs import ProcessJobs
from hal.owner import sole_user

TOKEN_FILE = "demo-token"
LOOK_DEADLINE_S = 60.0
"""Seconds of the wall that the page of a run's scans may take."""
_log = logging.getLogger(__name__)


class Workplace(SafeCell, Protocol):
    """Cell, vision and records, ready for orders: all that the service needs of what is below it."""

    @property
    def failure(self) -> str:
        """Why no order can be worked on, or an empty string."""
        ...

    @property
    def unreachable(self) -> str:
        """Why devices are not connected, or an empty string."""
        ...

    def is_simulated(self) -> bool:
        """Whether any device is a simulation, or may be one because it is not connected."""
        ...

    async def connect(self) -> str:
        """Connect what is not connected; the reason where that failed, or an empty string."""
        ...

    def faults(self, recipe: Recipe) -> tuple[Fault, ...]:
        """What makes the recipe unfit for this cell."""
        ...

    async def ready(self) -> str:
        """The reason against Idle, or an empty string."""
        ...

    async def until_unsafe(self) -> str:
        """Returns the reason once a safety input is open."""
        ...

    async def session(self, order: Order, recipe: Recipe) -> Session:
        """A run of that order. Raises CellError where the cell cannot be set up for it."""
        ...

    async def on_twin(self, recipe: Recipe, seed: int) -> TwinOutcome:
        """A run on a private twin."""
        ...

    def time_left_s(self, snapshot: Snapshot) -> float | None:
        """Cell seconds to the end of the run, where known."""
        ...


OpenWorkplace = Callable[[CellConfig, RecipeBook, RunStore, Stamps, Path], AsyncIterator[Workplace]]


@dataclass(frozen=True, slots=True)
class Service:
    """A service that listens. `token` is the demo's, empty where the sign-in is by keys; `stop` ends it."""

    url: str
    token: str
    services: Services
    data: Path
    stop: Callable[[], None]


async def serve(
    settings: Settings, open_workplace: OpenWorkplace, *, during: Callable[[Service], Awaitable[None]] | None = None
) -> None:
    """Serve until SIGTERM, SIGINT or `Service.stop`, or, with `during`, until that has returned.

    Raises ConfigError for files or settings that do not fit, DeviceRefused where the cell's devices are in other hands,
    and what `during` raises.
    """
    config = load_cell(settings.cell)
    refuse_unfit(settings, config)
    sock = _socket(settings)
    async with AsyncExitStack() as stack:
        stack.callback(sock.close)
        if real_devices(config):  # fakes live in this process
            stack.enter_context(sole_user(config.path))
        auth, token = _sign_in(settings, config)
        services = await _services(stack, settings, config, auth, open_workplace)
        app = create_app(services)
        await _warm(app)
        server = make_server(app, wall_s=settings.speed)
        await stack.enter_async_context(_listening(server, sock))
        told = asyncio.Event()
        service = Service(f"http://{_host(settings.host)}:{server.port}", token, services, settings.data, told.set)
        with ending(told.set):
            await _until(told, during(service) if during is not None else None)
            # The cell is stopped while the API can still be watched; then open streams end, so that none of them
            # holds up the server.
            await services.controller.shutdown()
            await services.dry_runs.close()
            services.events.close()


def _socket(settings: Settings) -> socket.socket:
    try:
        return bound(settings.host, settings.port)
    except OSError as error:
        raise ConfigError(f"port {settings.port} cannot be used: {error.strerror}", place="--port") from None


async def _services(
    stack: AsyncExitStack,
    settings: Settings,
    config: CellConfig,
    auth: Authenticator,
    open_workplace: OpenWorkplace,
) -> Services:
    stamps = WallStamps()
    events = EventLog(stamps.now)
    store = RunStore(settings.data)
    book = load_book(settings.recipes)
    settings.data.mkdir(parents=True, exist_ok=True)
    opened = asynccontextmanager(open_workplace)(config, book, store, stamps, settings.data)
    workplace = await stack.enter_async_context(opened)
    controller = Controller(
        workplace,
        events,
        safe_deadline_s=config.cell.safe_deadline_s,
        ready=workplace.ready,
        connect=workplace.connect,
        wall_s=settings.speed,
    )
    stack.push_async_callback(controller.shutdown)
    metrics = Metrics(controller, events)
    # Its processes start with the first job: nobody may ever look at a scan.
    jobs = ProcessJobs(deadline_s=LOOK_DEADLINE_S, modules=("cellctl.view.of_run",), stops_clock=False)
    stack.push_async_callback(jobs.close)

    def check(name: str, version: int) -> Recipe:
        return fitting(book, workplace, name, version)

    orders = OrderBook(
        settings.data / "orders.jsonl", controller, events, stamps, check=check, open_session=workplace.session
    )
    dry_runs = DryRuns(workplace.on_twin, stamps)
    stack.push_async_callback(dry_runs.close)
    await stack.enter_async_context(_background(watch_safety(controller, workplace.until_unsafe)))
    await _begin(workplace, controller, orders, store, stamps)
    return Services(
        cell_name=config.cell.name,
        controller=controller,
        orders=orders,
        events=events,
        recipes=book,
        runs=store,
        dry_runs=dry_runs,
        auth=auth,
        metrics=metrics,
        not_ready=lambda: workplace.failure,
        is_simulated=workplace.is_simulated,
        time_left_s=workplace.time_left_s,
        jobs=jobs,
        wall_s=settings.speed,
    )


async def _begin(
    workplace: Workplace, controller: Controller, orders: OrderBook, store: RunStore, stamps: Stamps
) -> None:
    """To Idle, or to Aborted where something is not as it should be.

    Whatever a run that was cut off was doing, nothing is known of it now, nor of devices that do not answer: a person
    looks before anything moves, and what is not connected is connected when that person clears.
    """
    interrupted = orders.interrupted()
    cut_off = "" if interrupted is None else await _give_up(interrupted, orders, store, stamps)
    if why := "; ".join(filter(None, (cut_off, workplace.unreachable))):
        controller.request(Command.ABORT, why)
    else:
        controller.request(Command.RESET)


async def _give_up(order: Order, orders: OrderBook, store: RunStore, stamps: Stamps) -> str:
    """Seal what is left of a run that was cut off; the sentence that the operator reads."""
    why = f"the service ended during run {order.run_id}"
    try:
        opened, unknown = await store.resume(order.run_id, stamps)
    except UnknownRun:
        pass  # it was cut off before its journal was begun
    except RecordError as error:
        why = f"{why}; its journal cannot be read: {error.reason}"
    else:
        if unknown:
            commands = ", ".join(sorted({f"{row.value['device']} {row.value['command']}" for row in unknown}))
            why = f"{why}; it is not known what became of: {commands}"
        await opened.end(RunEnded("Aborted", "held", (why,)))
    await orders.give_up(order)
    return why


def fitting(book: RecipeBook, workplace: Workplace, name: str, version: int) -> Recipe:
    """The recipe of that id and version. Raises OrderRefused with every reason against it."""
    recipe = book.get(name, version)
    if recipe is None:
        known = book.versions(name)
        pointer = "/recipe_version" if known else "/recipe"
        limit = ", ".join(map(str, known)) if known else ""
        fault = Fault(pointer, "no such recipe" if not known else "no such version", limit)
        raise OrderRefused("recipe_unknown", f"no recipe {name} version {version}", (fault,))
    faults = workplace.faults(recipe)
    if faults:
        raise OrderRefused("recipe_unfit", f"recipe {name} version {version} does not fit this cell", faults)
    return recipe


def _sign_in(settings: Settings, config: CellConfig) -> tuple[Authenticator, str]:
    """Who is let in, and the demo's token or an empty string. Raises ConfigError for a file of keys that is none."""
    if config.auth.mode == "keys":
        return KeyAuth(config.keys_path), ""
    auth = _demo_auth(settings.data)
    return auth, auth.token


def _demo_auth(data: Path) -> DemoAuth:
    """A new token at every start, readable by this user only."""
    auth = DemoAuth()
    data.mkdir(parents=True, exist_ok=True)
    path = data / TOKEN_FILE
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(auth.token + "\n")
    return auth


async def _warm(app: FastAPI) -> None:
    """Call every plain route once, then keep what start-up made out of the garbage collector's way. Nobody else can
    call yet: for that time a token that is told to nobody is let in."""
    services: Services = app.state.services
    own = DemoAuth()
    app.state.services = dataclasses.replace(services, auth=own)
    headers = {"Authorization": f"Bearer {own.token}"}
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://warm", headers=headers) as client:
        for route in declared(app):
            if "GET" in route.methods and "{" not in route.path and not route.path.endswith("/events"):
                await client.get(route.path)
            elif "POST" in route.methods and isinstance(route.access, Allow):
                await client.post(route.path, json={})
    async with httpx.AsyncClient(transport=httpx.ASGITransport(StreamingResponse(_nothing()))) as client:
        await client.get("http://warm")  # what streaming needs is imported with the first stream
    app.state.services = services
    gc.collect()
    gc.freeze()


async def _nothing() -> AsyncIterator[bytes]:
    yield b""


@asynccontextmanager
async def _listening(server: Server, sock: socket.socket) -> AsyncIterator[None]:
    serving = asyncio.create_task(server.serve_on(sock))
    listening = asyncio.create_task(server.listening.wait())
    await asyncio.wait({serving, listening}, return_when=asyncio.FIRST_COMPLETED)
    try:
        if serving.done():
            listening.cancel()
            serving.result()
        yield
    finally:
        server.stop()
        await asyncio.wait({serving})


@asynccontextmanager
async def _background(work: Awaitable[None]) -> AsyncIterator[None]:
    task = asyncio.ensure_future(work)
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def _until(told: asyncio.Event, during: Awaitable[None] | None) -> None:
    """Until somebody tells the service to end or `during` has returned, whichever is first."""
    end = asyncio.ensure_future(told.wait())
    tasks = {end} if during is None else {end, asyncio.ensure_future(during)}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)


def _host(host: str) -> str:
    return f"[{host}]" if ":" in host else host
