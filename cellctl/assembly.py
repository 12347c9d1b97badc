"""One assembly as a session of the controller: recipe checked, run opened, phases run, record sealed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version

from cellctl.calibrated_devices import other_devices
from cellctl.calibration import Calibration
from cellctl.ports import Checkpoint, Devices, GuardPlan, Interlock, Progress, RunContext, RunHeld, Vision
from cellctl.recipe import Recipe
from cellctl.recipe_checks import check, insertion_trip_n
from cellctl.records.blobs import Keep
from cellctl.records.store import OpenRun, RunStore
from cellctl.records.summary import RunEnded, RunHeader
from cellctl.sequence import assemble
from cellctl.session import Outcome, RunEnd
from cellctl.stamps import Stamps
from cellctl.steps.results import RunResult
from hal.config import CellConfig
from hal.interfaces import Identity


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be assembled. `forced` names physics checks that are skipped; they stand in the record."""

    run_id: str
    job_order_id: str
    recipe: Recipe
    rotor_serial: str
    shaft_serial: str
    forced: tuple[str, ...] = ()
    seed: int | None = None
    level: str | None = None
    keep: Keep = "all"


@dataclass(frozen=True, slots=True)
class Bench:
    """What every assembly of one cell is done with."""

    devices: Devices
    interlock: Interlock
    vision: Vision
    config: CellConfig
    calibration: Calibration
    store: RunStore
    stamps: Stamps
    identities: Mapping[str, Identity]


class Assembly:
    """`cellctl.session.Session`."""

    def __init__(
        self,
        order: Order,
        bench: Bench,
        *,
        on_phase: Callable[[str], None] | None = None,
        replace_stored: bool = False,
    ) -> None:
        self._order = order
        self._bench = bench
        self._on_phase = on_phase
        self._replace_stored = replace_stored
        self._open: OpenRun | None = None
        self.result: RunResult | None = None

    @property
    def run_id(self) -> str:
        """Id of the run."""
        return self._order.run_id

    @property
    def job_order_id(self) -> str:
        """Id that the MES gave to the order."""
        return self._order.job_order_id

    async def prepare(self) -> None:
        """Recipe against physics, cell and calibration; run opened. Raises RunHeld, ConfigError."""
        bench, order = self._bench, self._order
        self._open = await bench.store.begin(
            header_of(order, bench), bench.stamps, keep=order.keep, replace=self._replace_stored
        )
        refuse_unfit(order, bench)

    async def execute(self, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        """The phases. What the run finds out is in `result` when this returns."""
        assert self._open is not None, "prepare comes first"
        bench, order = self._bench, self._order
        self.result = await assemble(
            RunContext(
                devices=bench.devices,
                recipe=order.recipe,
                calibration=bench.calibration,
                guard_plan=guard_plan(order.recipe, bench.config),
                ledger=self._open.ledger,
                progress=PhaseWatch(progress, self._on_phase),
                checkpoint=checkpoint,
                interlock=bench.interlock,
                vision=bench.vision,
                rotor_serial=order.rotor_serial,
                shaft_serial=order.shaft_serial,
            )
        )
        return Outcome(self.result.verdict.verdict, self.result.verdict.reasons)

    async def close(self, end: RunEnd) -> None:
        """Journal the end, seal the record."""
        opened, self._open = self._open, None
        if opened is not None:
            ended = RunEnded(end.ending.capitalize(), end.outcome.verdict, end.outcome.reasons)
            await opened.end(ended)


class PhaseWatch:
    """Progress that also tells when a phase begins."""

    def __init__(self, progress: Progress, on_phase: Callable[[str], None] | None) -> None:
        self._progress = progress
        self._on_phase = on_phase
        self._phase = ""

    def report(self, phase: str, fraction: float, text: str) -> None:
        """Pass it on; a new phase is told once."""
        if phase != self._phase and self._on_phase is not None:
            self._on_phase(phase)
        self._phase = phase
        self._progress.report(phase, fraction, text)


def header_of(order: Order, bench: Bench) -> RunHeader:
    """The first row of the run's journal."""
    return RunHeader(
        run_id=order.run_id,
        job_order_id=order.job_order_id,
        recipe=order.recipe.model_dump(mode="json"),
        recipe_hash=order.recipe.content_hash,
        cell=bench.config.cell.name,
        calibration_id=bench.calibration.id,
        calibration_hash=bench.calibration.content_hash,
        rotor_serial=order.rotor_serial,
        shaft_serial=order.shaft_serial,
        software=version("cellctl"),
        seed=order.seed,
        level=order.level,
        forced=order.forced,
        devices=bench.identities,
        backends=bench.config.kinds,
    )


def refuse_unfit(order: Order, bench: Bench) -> None:
    """Raises RunHeld with every finding that was not forced, or where the calibration is out of date or of other
    devices than are there."""
    findings = [
        finding for finding in check(order.recipe, bench.config, bench.calibration) if finding.name not in order.forced
    ]
    if findings:
        raise RunHeld("recipe_refused", "; ".join(f"{f.name}: {f.reason}" for f in findings))
    if not bench.calibration.valid_at(bench.stamps.now()):
        raise RunHeld("calibration_expired", f"calibration {bench.calibration.id} is not valid today")
    if others := other_devices(bench.calibration, bench.identities):
        raise RunHeld("calibration_of_others", "; ".join(others))


def guard_plan(recipe: Recipe, config: CellConfig) -> GuardPlan:
    """Trip force and block sizes from recipe and cell file."""
    return GuardPlan(
        insert_trip_n=insertion_trip_n(recipe, config),
        stale_ms=config.guard.stale_ms,
        contact_block=config.guard.contact_block,
    )
