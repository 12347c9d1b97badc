"""The assembly on one screen: scan -> align -> jack up -> heat -> tighten -> evaluate."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TypeVar

from cellctl.ports import RunContext
from cellctl.steps.align import align_shaft
from cellctl.steps.close import close_joint
from cellctl.steps.evaluate import evaluate
from cellctl.steps.heat import heat
from cellctl.steps.jack_up import jack_up
from cellctl.steps.results import RunResult
from cellctl.steps.scan import prepare, scan
from cellctl.steps.seat import seat
from cellctl.steps.tighten import tighten

PHASES = ("scan", "align", "jack_up", "heat", "tighten")
T = TypeVar("T")


async def assemble(run: RunContext) -> RunResult:
    """One whole assembly. Raises RunHeld where the run cannot go on by itself, and the errors of the devices."""
    await _phase(run, "scan", prepare(run))
    scans = await _step(run, "scan", scan(run))
    aligned = await _phase(run, "align", align_shaft(run, scans))
    insertion = await _phase(run, "jack_up", jack_up(run, aligned))
    proof = await _phase(run, "heat", heat(run, aligned)) if run.recipe.heat.enabled else None
    seating = await _step(run, "heat", seat(run, aligned, insertion, proof))
    tightened = await _phase(run, "tighten", tighten(run))
    closure = await _step(run, "tighten", close_joint(run))
    verdict = evaluate(run.recipe, insertion, proof, seating, tightened, closure)
    await run.ledger.note("verdict", verdict)
    return RunResult(scans, aligned, insertion, proof, seating, tightened, closure, verdict)


async def _phase(run: RunContext, name: str, step: Awaitable[T]) -> T:
    """Begin a phase with its first step."""
    run.progress.report(name, 0.0, "started")
    return await _step(run, name, step)


async def _step(run: RunContext, name: str, step: Awaitable[T]) -> T:
    """Await one step of the phase, journal what it returned before the next one starts."""
    result = await step
    await run.ledger.note(f"phase_{name}", result)
    return result
