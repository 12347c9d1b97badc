"""Cell, vision and records of the service, ready for orders: composition root below `cellctl.app`.

A twin carries the parts of one recipe at a time: where devices are fake, an order for another joint sets the bench up
anew. What belongs to the plant stays in here; controller, journal and API have no way to it.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from cellctl.assembly import Assembly, Bench
from cellctl.assembly import Order as AssemblyOrder
from cellctl.believed_twin import numbers_of
from cellctl.calibrated_devices import other_devices
from cellctl.calibration import Calibration, load_calibration
from cellctl.controller import Snapshot
from cellctl.dry_runs import TwinOutcome
from cellctl.orders import Fault, Order
from cellctl.ports import Checkpoint, Progress, RunHeld
from cellctl.recipe import Recipe
from cellctl.recipe_book import RecipeBook
from cellctl.recipe_checks import check
from cellctl.records.store import RunStore
from cellctl.runner import RunRequest, run_once
from cellctl.scan_gates import gates_of
from cellctl.session import Outcome, RunEnd, SafeReport, Session, Verdict
from cellctl.stamps import Stamps
from cellctl.time_left import time_left_s
from cellctl.twin import RENDERING, StandingCell, standing_cell
from cellctl.vision.worker import WARM, VisionWorker
from hal.config import CellConfig
from hal.errors import CellError, ConfigError
from hal.interfaces import Identity
from hal.jobs import ProcessJobs

JOB_DEADLINE_S = 60.0
DRY_RUN_DEADLINE_S = 300.0
"""Seconds of the wall."""
DRY_RUN_POINTS = 300_000
NOT_CONNECTED = "the devices are not connected"


async def open_workplace(
    config: CellConfig, book: RecipeBook, store: RunStore, stamps: Stamps, data: Path
) -> AsyncIterator[CellWorkplace]:
    """The workplace of one cell, set up for the first recipe that fits it. Closes everything at the end.

    A device that does not answer is no error: the workplace says so in `unreachable`, and `connect` tries again.
    """
    calibration = load_calibration(config.calibration_path)
    jobs = ProcessJobs(deadline_s=JOB_DEADLINE_S, modules=(*WARM, *RENDERING))
    twin_jobs = ProcessJobs(deadline_s=DRY_RUN_DEADLINE_S, modules=("cellctl.runner",), stops_clock=False)
    async with jobs, twin_jobs:
        first = next((recipe for recipe in book.all() if not _faults(recipe, config, calibration)), None)
        if first is None:
            raise ConfigError("no recipe here fits this cell", place="--recipes")
        workplace = CellWorkplace(config, calibration, store, stamps, jobs, twin_jobs, first)
        try:
            await workplace.connect()
            yield workplace
        finally:
            await workplace.close()


class CellWorkplace:
    """See `cellctl.app.Workplace`."""

    def __init__(
        self,
        config: CellConfig,
        calibration: Calibration,
        store: RunStore,
        stamps: Stamps,
        jobs: ProcessJobs,
        twin_jobs: ProcessJobs,
        first: Recipe,
    ) -> None:
        self._config = config
        self._calibration = calibration
        self._store = store
        self._stamps = stamps
        self._jobs = jobs
        self._twin_jobs = twin_jobs
        self._bench = self._built(first)
        self._identities: dict[str, Identity] = {}
        self._expected: dict[str, tuple[tuple[str, float], ...]] = {}
        self._unfit = ""
        self.unreachable = NOT_CONNECTED

    @property
    def failure(self) -> str:
        """Why no order can be worked on, or an empty string."""
        return self.unreachable or self._unfit

    def is_simulated(self) -> bool:
        """Whether any device is a simulation, as they all may be while none is connected."""
        return any(identity.simulated for identity in self._identities.values()) or not self._identities

    async def connect(self) -> str:
        """Connect what is not connected; the reason where that failed, else an empty string."""
        if self.unreachable:
            try:
                self._identities = await self._bench.cell.connect()
            except CellError as error:
                self.unreachable = str(error)
            else:
                self.unreachable = ""
                others = other_devices(self._calibration, self._identities)
                self._unfit = refused_sign_in(self._config.auth.mode, self._identities) or "; ".join(others)
        return self.unreachable

    async def close(self) -> None:
        """Let go of the devices."""
        await self._bench.cell.close()

    async def make_safe(self, deadline_s: float) -> SafeReport:
        """See `hal.cell.Cell.make_safe`."""
        return await self._bench.cell.make_safe(deadline_s)

    async def rearm(self) -> None:
        """Every set-point becomes what is measured, on devices that are connected. Raises CellError."""
        if not await self.connect() and not self.failure:
            await self._bench.cell.rearm()

    async def ready(self) -> str:
        """The reason against Idle, or an empty string."""
        return self.failure

    async def until_unsafe(self) -> str:
        """Returns the reason once a safety input is open."""
        return await self._bench.cell.until_unsafe()

    def faults(self, recipe: Recipe) -> tuple[Fault, ...]:
        """What the physics checks find against the recipe on this cell."""
        return _faults(recipe, self._config, self._calibration)

    async def session(self, order: Order, recipe: Recipe) -> Session:
        """A run of that order on a bench that is set up for its recipe. Raises CellError."""
        await self._set_up(recipe)
        wanted = order.wanted
        assembly = Assembly(
            AssemblyOrder(order.run_id, wanted.job_order_id, recipe, wanted.rotor_serial, wanted.shaft_serial),
            Bench(
                devices=self._bench.cell,
                interlock=self._bench.cell.guard,
                vision=VisionWorker(self._jobs, self._calibration, gates=gates_of(recipe)),
                config=self._config,
                calibration=self._calibration,
                store=self._store,
                stamps=self._stamps,
                identities=self._identities,
            ),
            on_phase=self._bench.enter_phase,
        )
        return _Tried(assembly, lambda: self._dry_run(order, recipe))

    async def on_twin(self, recipe: Recipe, seed: int) -> TwinOutcome:
        """A run on a private twin in a worker process: the calibration's belief is its truth."""
        return await self._twin_jobs.run(run_on_twin, recipe, self._config, seed, latency_s=0.0)

    def time_left_s(self, snapshot: Snapshot) -> float | None:
        """From how long the phases took in the dry run."""
        return time_left_s(self._expected.get(snapshot.run_id or "", ()), snapshot.phase, snapshot.fraction)

    async def _dry_run(self, order: Order, recipe: Recipe) -> None:
        seed = int(order.wanted.fingerprint[:8], 16)
        outcome = await self.on_twin(recipe, seed)
        self._expected = {order.run_id: outcome.phases_s}
        if outcome.verdict != "accepted":
            reasons = "; ".join(outcome.reasons) or "no reason given"
            raise RunHeld("dry_run_refused", f"the dry run on the twin was {outcome.verdict}: {reasons}")

    async def _set_up(self, recipe: Recipe) -> None:
        if self._bench.carries(recipe):
            return
        await self._bench.cell.close()
        self._bench = self._built(recipe)
        self.unreachable = NOT_CONNECTED
        if await self.connect() or self.failure:
            raise CellError(self.failure)
        await self._bench.cell.rearm()  # this bench is another one than the reset has made ready

    def _built(self, recipe: Recipe) -> StandingCell:
        return standing_cell(recipe, self._config, self._jobs, seed=self._config.twin.seed)


def refused_sign_in(mode: str, identities: Mapping[str, Identity]) -> str:
    """Why nobody may work with these devices under the sign-in of the cell file, or an empty string."""
    metal = [name for name, identity in identities.items() if mode == "demo" and not identity.simulated]
    return f"the demo's sign-in is for simulated devices; these are not: {', '.join(metal)}" if metal else ""


class _Tried:
    """An assembly that begins only after its dry run, so that its journal holds the cell's own time alone."""

    def __init__(self, assembly: Assembly, dry_run: Callable[[], Awaitable[None]]) -> None:
        self._assembly = assembly
        self._dry_run = dry_run

    @property
    def run_id(self) -> str:
        return self._assembly.run_id

    @property
    def job_order_id(self) -> str:
        return self._assembly.job_order_id

    async def prepare(self) -> None:
        await self._dry_run()
        await self._assembly.prepare()

    async def execute(self, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        return await self._assembly.execute(checkpoint, progress)

    async def close(self, end: RunEnd) -> None:
        await self._assembly.close(end)


def run_on_twin(recipe: Recipe, config: CellConfig, seed: int) -> TwinOutcome:
    """A run in virtual time on an ideal twin that knows nothing of the cell's own plant. Blocking."""
    calibration = load_calibration(config.calibration_path)
    believed = numbers_of(calibration)
    of_any_device = calibration.model_copy(update={"made": {}})  # the twin's own are not those it was made with
    twin = config.twin.model_copy(update={"level": "ideal", "overrides": believed, "points": DRY_RUN_POINTS})
    private = config.on_fakes().model_copy(update={"twin": twin})
    with TemporaryDirectory(prefix="cellctl-dry-run-") as folder:
        outcome = run_once(RunRequest(recipe, private, seed, Path(folder), keep="none", calibration=of_any_device))
    summary = outcome.summary
    phases = tuple((phase.name, phase.cell_time_s) for phase in summary.phases) if summary else ()
    cell_time_s = summary.cell_time_s if summary else 0.0
    return TwinOutcome(_verdict(outcome.verdict), outcome.reasons, cell_time_s, phases)


def _verdict(verdict: str) -> Verdict:
    return "accepted" if verdict == "accepted" else "rejected" if verdict == "rejected" else "held"


def _faults(recipe: Recipe, config: CellConfig, calibration: Calibration) -> tuple[Fault, ...]:
    """Findings as faults of an order's recipe; the place in the recipe stands in the reason."""
    findings = check(recipe, config, calibration)
    return tuple(
        Fault("/recipe", f"{finding.name}: {finding.place}: {finding.reason}", finding.limit, finding.unit)
        for finding in findings
    )
