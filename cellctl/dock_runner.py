"""One dock alone on a twin of its own: by sight (scan, align, jack up to the spigot), or from a pose that is given.

The composition root of studies, beside `cellctl.runner`: it owns the plant and takes the truth out by its door after
the dock has ended. Nothing is written to a disk: the journal is in memory, scans are only hashed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from cellctl.assembly import guard_plan
from cellctl.calibration import Calibration, load_calibration
from cellctl.ports import RunContext, RunHeld
from cellctl.recipe import Recipe
from cellctl.recipe_checks import check
from cellctl.records.blobs import HashOnly
from cellctl.records.journal import Journal
from cellctl.records.ledger import JournalLedger
from cellctl.scan_gates import gates_of
from cellctl.stamps import VirtualStamps
from cellctl.steps.align import align_shaft
from cellctl.steps.jack_up import jack_up
from cellctl.steps.results import Aligned, Insertion
from cellctl.steps.scan import prepare, scan
from cellctl.twin import FakeCell, fake_cell, geometry_of, truth_limits
from cellctl.vision.worker import VisionWorker
from hal.clock import run_virtual
from hal.config import CellConfig
from hal.errors import CellError
from hal.fake.contact.docking import DockForces, at_best_pose, dock_forces, moved
from hal.fake.levels import numbers
from hal.fake.plant import Plant, TwinSettings
from hal.fake.truth import Truth, TruthLimits, truth_of
from hal.jobs import InlineJobs

ROTOR_SERIAL, SHAFT_SERIAL = "R-1", "S-1"


@dataclass(frozen=True, slots=True)
class DockRequest:
    """What is to be docked. Level, overrides and points stand in the cell's `[twin]`; the seed draws cell and parts."""

    recipe: Recipe
    config: CellConfig
    seed: int


@dataclass(frozen=True, slots=True)
class Offset:
    """Shaft's pose minus its best pose, about the rotor's axis; theta right-handed about cell z."""

    theta_deg: float
    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """What the controller believed before it jacked up: one sigma of the pose, odds, loops of the alignment.

    `left` is what it saw still to go inside its gates, best pose minus pose; added to the true offset it leaves the
    error of the estimate, which is what the sigmas speak of.
    """

    left: Offset
    sigma_theta_deg: float
    sigma_xy_mm: float
    p_insert: float
    loops: int


@dataclass(frozen=True, slots=True)
class DockOutcome:
    """How a dock really ended. Forces up to the spigot, newton.

    `refused` is the code of a hold before all studs were in, and then counts as neither inserted nor below the limit.
    `reason` is empty where all studs went in at the first attempt and none met more than the limit.
    """

    seed: int
    inserted: bool
    force_ok: bool
    first_attempt: bool
    peak_total_n: float
    peak_bolt_n: float
    offset: Offset
    reason: str = ""
    refused: str = ""
    forecast: Forecast | None = None

    @property
    def succeeded(self) -> bool:
        """All inserted and no stud above the limit, at the first attempt."""
        return self.inserted and self.force_ok and self.first_attempt and not self.refused


def require_dockable(recipe: Recipe, config: CellConfig) -> None:
    """Raises ConfigError where no twin can be built to the recipe or an override is unknown."""
    geometry_of(recipe)
    numbers(config.twin.level, config.twin.overrides)


def dock_from(request: DockRequest, offset: Offset) -> DockOutcome:
    """Insert up to the spigot from the best pose plus `offset`, whatever the force: no vision, no gate, no retry."""
    twin = request.config.twin
    plant = Plant(geometry_of(request.recipe), TwinSettings(request.seed, twin.level, twin.overrides))
    plant.load_parts(ROTOR_SERIAL, SHAFT_SERIAL)
    forces = dock_forces(moved(at_best_pose(plant.dock()), offset.x_mm, offset.y_mm, offset.theta_deg))
    inserted, peak_n = bool(forces.inserted.all()), float(forces.peak_n.max())
    return DockOutcome(
        seed=request.seed,
        inserted=inserted,
        force_ok=inserted and peak_n <= _limit_n(),
        first_attempt=True,
        peak_total_n=forces.peak_total_n,
        peak_bolt_n=peak_n,
        offset=offset,
        reason=_why_from(forces),
    )


def dock_by_sight(request: DockRequest) -> DockOutcome:
    """The production steps up to the spigot, under virtual time: real clouds, gates, loops, guard and retries."""
    return run_virtual(_dock(request))


async def _dock(request: DockRequest) -> DockOutcome:
    twin = fake_cell(request.recipe, request.config, InlineJobs(), seed=request.seed)
    stamps = VirtualStamps(request.seed)
    journal = await Journal.open(None, stamps)
    aligned, insertion, refused, reason = None, None, "", ""
    try:
        await twin.cell.connect()
        await twin.cell.rearm()
        calibration = load_calibration(request.config.calibration_path)
        _require_fit(request, calibration)
        run = _context(request, twin, calibration, JournalLedger(journal, HashOnly(), stamps))
        await prepare(run)
        aligned = await align_shaft(run, await scan(run))
        insertion = await jack_up(run, aligned)
    except (RunHeld, CellError) as stopped:
        refused, reason = stopped.code, str(stopped)
    finally:
        await twin.cell.close()
        await journal.close()
    return _outcome(request, twin.plant, aligned, insertion, refused, reason)


def _context(request: DockRequest, twin: FakeCell, calibration: Calibration, ledger: JournalLedger) -> RunContext:
    return RunContext(
        devices=twin.cell,
        recipe=request.recipe,
        calibration=calibration,
        guard_plan=guard_plan(request.recipe, request.config),
        ledger=ledger,
        progress=_Unwatched(),
        checkpoint=_never_held,
        interlock=twin.cell.guard,
        vision=VisionWorker(InlineJobs(), calibration, gates=gates_of(request.recipe), seed=request.seed),
        rotor_serial=ROTOR_SERIAL,
        shaft_serial=SHAFT_SERIAL,
    )


class _Unwatched:
    """Progress that nobody looks at."""

    def report(self, phase: str, fraction: float, text: str) -> None:
        """Told to nobody."""


async def _never_held(
    retreat: Callable[[], Awaitable[None]] | None = None,
    resume: Callable[[], Awaitable[None]] | None = None,
    *,
    ask: str = "",
) -> None:
    """A checkpoint without anybody who could ask for a hold; other tasks get their turn."""
    await asyncio.sleep(0)


def _require_fit(request: DockRequest, calibration: Calibration) -> None:
    findings = check(request.recipe, request.config, calibration)
    if findings:
        raise RunHeld("recipe_refused", "; ".join(f"{finding.name}: {finding.reason}" for finding in findings))


def _outcome(
    request: DockRequest,
    plant: Plant,
    aligned: Aligned | None,
    insertion: Insertion | None,
    refused: str,
    reason: str,
) -> DockOutcome:
    truth, tries = truth_of(plant, truth_limits(request.recipe)), insertion.tries if insertion else 0
    inserted = truth.inserted and insertion is not None
    peak_n = max(truth.peak_force_per_bolt_n)
    return DockOutcome(
        seed=request.seed,
        inserted=inserted,
        force_ok=inserted and peak_n <= _limit_n(),
        first_attempt=tries == 1,
        peak_total_n=plant.engagement.peak_total_n,
        peak_bolt_n=peak_n,
        offset=Offset(truth.theta_error_deg, truth.x_error_mm, truth.y_error_mm),
        reason=reason or _why_by_sight(truth, tries),
        refused=refused,
        forecast=_forecast(aligned) if aligned else None,
    )


def _forecast(aligned: Aligned) -> Forecast:
    alignment = aligned.alignment
    left = Offset(alignment.theta_deg, alignment.x_mm, alignment.y_mm)
    return Forecast(left, alignment.sigma_theta_deg, alignment.sigma_xy_mm, alignment.p_insert, aligned.loops)


def _limit_n() -> float:
    return TruthLimits().force_per_bolt_n


def _above(peak_n: float) -> str:
    return f"a stud met {peak_n:.2f} N (limit {_limit_n():g} N)" if peak_n > _limit_n() else ""


def _why_from(forces: DockForces) -> str:
    if not forces.inserted.all():
        return "a stud's end met the flange outside its chamfer"
    return _above(float(forces.peak_n.max()))


def _why_by_sight(truth: Truth, tries: int) -> str:
    if not truth.inserted:
        return "not all studs are inserted"
    return _above(max(truth.peak_force_per_bolt_n)) or (f"inserted at try {tries}" if tries > 1 else "")
