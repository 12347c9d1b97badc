"""Phase jack up: the shaft rises under a force guard until all studs are in, up to the spigot."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace

import numpy as np

from cellctl.ports import RunContext, RunHeld
from cellctl.steps.motion import camera_to, move, require_clamped, require_safety
from cellctl.steps.results import Aligned, Insertion
from cellctl.steps.together import together
from hal.errors import GuardTripped, Interrupted
from hal.interfaces import GuardLimits, GuardState
from hal.units import GRAVITY_M_S2

SEGMENT_MM = 2.0
"""Between two checkpoints: a hold never waits for longer than one segment of the insertion."""
CREEP_MM = 2.0
"""The tare is taken while creeping towards the studs, the last bit before contact is possible."""


@dataclass(frozen=True, slots=True)
class Tare:
    """Net force is raw minus `tare_n`; `weight_n` is what stood on the cell at rest."""

    weight_n: float
    tare_n: float


async def jack_up(run: RunContext, aligned: Aligned) -> Insertion:
    """Insert all studs below the recipe's force limit. Raises RunHeld after the last try or on a wrong weight."""
    if asyncio.get_running_loop().time() > aligned.expires_at_s:
        raise RunHeld("alignment_expired", f"the alignment is older than {run.recipe.align.expires_s} s: scan again")
    await require_safety(run)
    await require_clamped(run)
    await move(run, "gun_feed", 0.0)
    await camera_to(run, "parked")
    weight = await _weigh(run)
    peak = 0.0
    for attempt in range(1, run.recipe.jack_up.max_tries + 1):
        run.progress.report("jack_up", 0.1, f"approach, try {attempt}")
        tare = await _approach(run, aligned, weight)
        state = await _insert(run, aligned, tare)
        peak = max(peak, state.peak_n)
        if not state.tripped:
            return await _result(run, tare, peak, attempt)
        await run.ledger.note("guard_trip", state)
        await back_off(run, aligned)
    if peak < run.guard_plan.insert_trip_n:  # no force: what the guard says is all that is known
        raise RunHeld("guard_tripped", f"the guard tripped in each of {attempt} tries, at last: {state.reason}")
    raise RunHeld(
        "force_limit",
        f"contact force reached {peak:.1f} N in each of {run.recipe.jack_up.max_tries} tries "
        f"(trip at {run.guard_plan.insert_trip_n:.1f} N): the studs do not enter",
    )


async def _weigh(run: RunContext) -> float:
    block = await run.interlock.window(run.recipe.jack_up.tare_seconds_s)
    weight = run.calibration.jack_force.true_n(float(np.mean(block.samples_n)))
    expected = run.recipe.limits.shaft_mass_kg * GRAVITY_M_S2
    await run.ledger.note("weight", {"weight_n": weight, "expected_n": expected})
    allowed = run.recipe.jack_up.weight_tolerance * expected
    if not abs(weight - expected) <= allowed:
        raise RunHeld(
            "weight_implausible",
            f"the shaft weighs {weight:.0f} N, expected {expected:.0f} +- {allowed:.0f} N: force gain or part is wrong",
        )
    return weight


async def _approach(run: RunContext, aligned: Aligned, weight_n: float) -> Tare:
    """Fast up to the stand-off, then the tare in creep right before contact is possible."""
    recipe = run.recipe
    start = aligned.alignment.approach_z_mm
    await run.checkpoint()
    gain, offset_n = run.calibration.jack_force.gain, run.calibration.jack_force.offset_n
    limits = guard_limits(run, "approach", weight_n / gain + offset_n, recipe.jack_up.approach_force_limit_n / gain)
    state = await guarded_move(run, start, recipe.jack_up.approach_speed_mm_s, limits)
    _require_free(state)
    state, block = await together(
        guarded_move(run, start + CREEP_MM, recipe.jack_up.contact_speed_mm_s, limits),
        run.interlock.window(recipe.jack_up.tare_seconds_s),
    )
    _require_free(state)
    return Tare(weight_n=weight_n, tare_n=float(np.mean(block.samples_n)))


def _require_free(state: GuardState) -> None:
    if state.tripped:
        raise RunHeld("force_on_approach", f"tripped on the approach, where nothing should touch: {state.reason}")


async def _insert(run: RunContext, aligned: Aligned, tare: Tare) -> GuardState:
    """Segments at contact speed under the insertion limit; the returned state has the peak of all of them.

    The record's force curve has the peak of each segment.
    """
    recipe = run.recipe
    end = aligned.alignment.target.z_mm - recipe.jack_up.spigot_gap_mm
    start = (await run.devices.jack.read()).position
    gain = run.calibration.jack_force.gain
    limits = guard_limits(run, "insert", tare.tare_n, run.guard_plan.insert_trip_n / gain)
    state = run.interlock.state()
    curve: list[tuple[float, float]] = []
    for mark in [*np.arange(start + SEGMENT_MM, end, SEGMENT_MM), end]:
        await run.checkpoint(lambda: back_off(run, aligned), lambda: _still_valid(aligned))
        run.progress.report("jack_up", 0.2 + 0.8 * (mark - start) / (end - start), f"inserting, jack at {mark:.1f} mm")
        state = await guarded_move(run, float(mark), recipe.jack_up.contact_speed_mm_s, limits)
        curve.append((float(mark), state.peak_n * gain))
        if state.tripped:
            break
    z_mm, force_n = np.array(curve).T
    await run.ledger.blob("force_curve", {"z_mm": z_mm, "force_n": force_n})
    return replace(state, peak_n=float(force_n.max()))


async def guarded_move(run: RunContext, position_mm: float, speed_mm_s: float, limits: GuardLimits) -> GuardState:
    """Move the jack under the guard. A trip is returned in the state, never raised; other errors pass."""
    await run.interlock.arm(limits)
    try:
        await move(run, "jack", position_mm, speed=speed_mm_s)
    except (Interrupted, GuardTripped):
        if not run.interlock.state().tripped:
            raise
    finally:
        state = await run.interlock.disarm()
    return state


async def back_off(run: RunContext, aligned: Aligned) -> None:
    """Clear a trip, then retract to the stand-off below the studs. Only ever moves down."""
    await run.interlock.rearm()
    await run.ledger.act("jack", "rearm", {}, lambda key: run.devices.jack.rearm())
    here = (await run.devices.jack.read()).position
    await move(run, "jack", min(aligned.alignment.approach_z_mm, here - run.recipe.jack_up.back_off_mm))


def guard_limits(run: RunContext, label: str, tare_n: float, trip_n: float) -> GuardLimits:
    """Limits in raw newton of the cell. Pulling by the same amount trips as well: the shaft would be hanging."""
    plan = run.guard_plan
    return GuardLimits(
        label=label,
        tare_n=tare_n,
        trip_n=trip_n,
        low_n=-max(trip_n, run.recipe.jack_up.approach_force_limit_n),
        stale_ms=plan.stale_ms,
        block=plan.contact_block,
    )


async def _still_valid(aligned: Aligned) -> None:
    if asyncio.get_running_loop().time() > aligned.expires_at_s:
        raise RunHeld("alignment_expired", "the alignment expired while the run was held: scan again")


async def _result(run: RunContext, tare: Tare, peak_n: float, tries: int) -> Insertion:
    jack = await run.devices.jack.read()
    return Insertion(
        inserted=True,
        z_mm=jack.position,
        weight_n=tare.weight_n,
        tare_n=tare.tare_n,
        trip_n=run.guard_plan.insert_trip_n,
        peak_total_n=peak_n,
        peak_bolt_n=None,
        force_basis=run.recipe.jack_up.force_basis,
        tries=tries,
    )
