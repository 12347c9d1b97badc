"""One assembly without the API: the only way to run without the service. Fakes run in virtual time, real devices in
their own.

The composition root that owns the plant behind fakes: it builds twin, cell, controller and record, and takes the truth
out by its one door after the run has ended. Nothing that runs inside can reach it.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import hashlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cellctl.assembly import Assembly, Bench, Order
from cellctl.calibration import Calibration, load_calibration
from cellctl.controller import Controller
from cellctl.event_log import EventLog
from cellctl.recipe import Recipe
from cellctl.records.blobs import Keep
from cellctl.records.store import RunStore
from cellctl.records.summary import RunSummary
from cellctl.safety_watch import watch_safety
from cellctl.scan_gates import gates_of
from cellctl.service_rules import real_devices
from cellctl.stamps import Stamps, VirtualStamps, WallStamps
from cellctl.states import Command, State
from cellctl.twin import StandingCell, standing_cell, truth_limits
from cellctl.vision.worker import WARM, VisionWorker
from hal.cell import Cell
from hal.clock import run_virtual
from hal.config import CellConfig, Level
from hal.errors import DeviceError
from hal.fake.fault_file import Fault
from hal.fake.truth import Truth, truth_of
from hal.interfaces import Identity
from hal.jobs import InlineJobs, Jobs, ProcessJobs
from hal.owner import sole_user

ENDED = (State.COMPLETE, State.HELD, State.STOPPED, State.ABORTED)


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What is to be run. `level`, `points` and `overrides` stand in the cell's `[twin]`; `jobs` render and measure.

    `calibration` takes the place of the one that the cell file names.
    """

    recipe: Recipe
    config: CellConfig
    seed: int
    data: Path
    faults: tuple[Fault, ...] = ()
    forced: tuple[str, ...] = ()
    keep: Keep = "decision"
    rotor_serial: str = "R-1"
    shaft_serial: str = "S-1"
    jobs: Jobs = field(default_factory=InlineJobs)
    calibration: Calibration | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """How the run ended, what it found out, and the truth beside it, which nobody knows of real devices. `record` is
    None where none could be written."""

    state: str
    verdict: str
    reasons: tuple[str, ...]
    seed: int
    wall_time_s: float
    summary: RunSummary | None
    truth: Truth | None
    record: Path | None
    overrides: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The document of `cellctl run --json`."""
        summary = self.summary
        return {
            "verdict": self.verdict,
            "state": self.state,
            "reasons": list(self.reasons),
            "seed": self.seed,
            "journal_hash": summary.journal_hash if summary else None,
            "cell_time_s": summary.cell_time_s if summary else 0.0,
            "wall_time_s": self.wall_time_s,
            "phases": [dataclasses.asdict(phase) for phase in summary.phases] if summary else [],
            "alignment": summary.alignment if summary else None,
            "insertion": summary.insertion if summary else None,
            "heat": summary.heat if summary else None,
            "joints": list(summary.joints) if summary else [],
            "truth": self.truth.as_dict() if self.truth else None,
            "record": str(self.record) if self.record else None,
        }


def run_once(request: RunRequest) -> Outcome:
    """Run one assembly to its end: under virtual time where every device is fake, in real time elsewhere.

    Raises ConfigError for a recipe the twin cannot be built to, DeviceRefused where the cell's devices are in other
    hands.
    """
    started = time.perf_counter()
    outcome = (
        asyncio.run(_run_in_real_time(request)) if real_devices(request.config) else run_virtual(run_here(request))
    )
    return dataclasses.replace(outcome, wall_time_s=time.perf_counter() - started)


async def _run_in_real_time(request: RunRequest) -> Outcome:
    """Whatever takes long is done in worker processes: drives are not left without their heartbeat."""
    with sole_user(request.config.path):
        async with ProcessJobs(modules=WARM) as jobs:
            return await run_here(dataclasses.replace(request, jobs=jobs))


@dataclass(frozen=True, slots=True)
class Composed:
    """One assembly on its cell, ready to be connected and driven."""

    twin: StandingCell
    controller: Controller
    assembly: Assembly
    store: RunStore
    identities: dict[str, Identity]

    async def connect(self) -> None:
        """Connect every device. Raises CellFailure."""
        self.identities.update(await self.twin.cell.connect())


def compose(request: RunRequest) -> Composed:
    """Twin, controller, record and the assembly on them. Must be called inside the running loop. Raises ConfigError."""
    twin = standing_cell(request.recipe, request.config, request.jobs, seed=request.seed, faults=request.faults)
    stamps: Stamps = WallStamps() if real_devices(request.config) else VirtualStamps(identity(request))
    controller = Controller(twin.cell, EventLog(stamps.now), safe_deadline_s=request.config.cell.safe_deadline_s)
    calibration = request.calibration or load_calibration(request.config.calibration_path)
    store = RunStore(request.data, durable=False)
    identities: dict[str, Identity] = {}
    order = Order(
        run_id=stamps.new_id("run"),
        job_order_id=f"run-{request.seed}",
        recipe=request.recipe,
        rotor_serial=request.rotor_serial,
        shaft_serial=request.shaft_serial,
        forced=request.forced,
        seed=request.seed,
        level=request.config.twin.level,
        keep=request.keep,
    )
    bench = Bench(
        devices=twin.cell,
        interlock=twin.cell.guard,
        vision=VisionWorker(request.jobs, calibration, gates=gates_of(request.recipe), seed=request.seed),
        config=request.config,
        calibration=calibration,
        store=store,
        stamps=stamps,
        identities=identities,
    )
    assembly = Assembly(order, bench, on_phase=twin.enter_phase, replace_stored=True)
    return Composed(twin, controller, assembly, store, identities)


async def run_here(request: RunRequest) -> Outcome:
    """As `run_once`, on the loop that runs already; `wall_time_s` is for the caller to measure."""
    made = compose(request)
    controller, cell, run_id = made.controller, made.twin.cell, made.assembly.run_id
    try:
        await made.connect()
    except DeviceError as error:
        await cell.close()
        return Outcome("Stopped", "held", (str(error),), request.seed, 0.0, None, _truth(request, made.twin), None)
    state = await _to_the_end(controller, cell, made.assembly)
    why = controller.snapshot().why
    await controller.shutdown()
    await cell.close()
    summary = await made.store.get(run_id)
    return Outcome(
        state=state.value,
        verdict=summary.verdict or "held",
        reasons=summary.reasons or ((why,) if why else ()),
        seed=request.seed,
        wall_time_s=0.0,
        summary=summary,
        truth=_truth(request, made.twin),
        record=made.store.record_path(run_id),
    )


def _truth(request: RunRequest, cell: StandingCell) -> Truth | None:
    return truth_of(cell.behind.plant, truth_limits(request.recipe)) if cell.behind is not None else None


async def _to_the_end(controller: Controller, cell: Cell, assembly: Assembly) -> State:
    """Reset, start, wait; the safety inputs are watched all the time, as in the service. The twin's operator has done
    at once what the run asks for."""
    controller.request(Command.RESET)
    await controller.until(State.IDLE, State.ABORTED, State.STOPPED)
    watch = asyncio.get_running_loop().create_task(watch_safety(controller, cell.until_unsafe))
    try:
        controller.start(assembly)
        while (state := await controller.until(State.SUSPENDED, *ENDED)) is State.SUSPENDED:
            controller.request(Command.UNSUSPEND)
        return state
    finally:
        watch.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await watch


def identity(request: RunRequest) -> int:
    """What ids follow from: seed, recipe and twin, so that another run never takes an earlier one's place."""
    twin = request.config.twin
    told = f"{request.seed}/{request.recipe.content_hash}/{twin.model_dump_json()}/{request.faults}/{request.forced}"
    return int.from_bytes(hashlib.sha256(told.encode()).digest()[:8], "big")


def with_twin(
    config: CellConfig,
    *,
    level: Level | None = None,
    points: int | None = None,
    overrides: Mapping[str, float] | None = None,
) -> CellConfig:
    """The same cell on another twin."""
    twin = config.twin.model_copy(
        update={
            "level": level or config.twin.level,
            "points": points or config.twin.points,
            "overrides": {**config.twin.overrides, **(overrides or {})},
        }
    )
    return config.model_copy(update={"twin": twin})
