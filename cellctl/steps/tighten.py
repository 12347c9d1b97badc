"""Phase tighten: nuts started, all stages over opposite pairs in star order, cooling, final stage, verification."""

from __future__ import annotations

import asyncio

from cellctl.kinematics import AxesPosition
from cellctl.ports import RunContext, RunHeld
from cellctl.steps.engage import engage_nuts, engage_sockets, retract
from cellctl.steps.heat import check_channels, look, mean_c
from cellctl.steps.joint import run_down, stage_program, verify_program
from cellctl.steps.motion import move, require_clamped, shaft_axes
from cellctl.steps.order import Pair, pairs
from cellctl.steps.results import HeatSample, JointResult, Tightened
from hal.interfaces import TighteningProgram

LOOK_S = 20.0
"""Cell seconds between two looks at the temperatures while the joint cools."""


async def tighten(run: RunContext) -> Tightened:
    """Every joint in every stage, each counted once. Raises RunHeld on the first joint that is not in its windows."""
    await require_clamped(run)
    await _require_nuts(run)
    at_start = await shaft_axes(run.devices)
    round_of_pairs = pairs(run.recipe.pattern.angles(), run.recipe.tighten.order)
    results: list[JointResult] = []
    stages = run.recipe.tighten.stages
    difference = float("nan")
    for number, stage in enumerate(stages):
        if stage.cold:
            difference = await cool(run)
        for place, pair in enumerate(round_of_pairs):
            share = (number + place / len(round_of_pairs)) / (len(stages) + 1)
            run.progress.report("tighten", share, f"{stage.name}: joints {pair.a} and {pair.b}")
            program = stage_program(run.recipe.tighten, stage)
            results += await _pair(run, pair, program, nuts=number == 0)
        await _check_drift(run, at_start)
    for place, pair in enumerate(round_of_pairs):
        share = (len(stages) + place / len(round_of_pairs)) / (len(stages) + 1)
        run.progress.report("tighten", share, f"verification: joints {pair.a} and {pair.b}")
        results += await _pair(run, pair, verify_program(run.recipe.tighten), nuts=False)
    drift = await _check_drift(run, at_start)
    await move(run, "gun_feed", 0.0)
    return Tightened(joints=tuple(results), drift_deg=drift, difference_at_final_k=difference)


async def _pair(run: RunContext, pair: Pair, program: TighteningProgram, *, nuts: bool) -> list[JointResult]:
    """One pair in one stage, from the checkpoint to the guns back; a hold lets the running pair finish."""
    await run.checkpoint()
    await require_clamped(run)
    await move(run, "gun_feed", 0.0)
    await move(run, "gun_table", pair.table_deg)
    tries = await (engage_nuts(run, pair) if nuts else engage_sockets(run, pair))
    results = await run_down(run, pair, program, tries)
    await retract(run)
    for result in results:
        await run.ledger.note("joint", result)
    bad = [result for result in results if result.verdict != "ok"]
    if bad:
        raise RunHeld("joint_not_ok", "; ".join(describe(result) for result in bad))
    return list(results)


def describe(result: JointResult) -> str:
    """One joint's result in words."""
    return (
        f"joint {result.index} (gun {result.gun}, {result.stage}) {result.verdict}: {result.torque_nm:.1f} Nm "
        f"{result.torque_band}, {result.angle_deg:.0f} deg {result.angle_band}"
        f", trace up to {result.trace_peak_nm:.1f} Nm"
    )


async def cool(run: RunContext) -> float:
    """Wait until the difference of the members is small enough for the final stage; returns it, kelvin."""
    recipe = run.recipe.tighten
    loop = asyncio.get_running_loop()
    start = loop.time()
    samples: list[HeatSample] = []
    while True:
        sample = await look(run)
        samples.append(sample)
        check_channels(run.recipe.heat, samples)
        difference = mean_c(sample) - sample.rotor_c
        run.progress.report("tighten", 0.5, f"cooling, {difference:.1f} K left")
        if abs(difference) <= recipe.final_below_difference_k:
            return difference
        if loop.time() - start > recipe.cooling_timeout_s:
            raise RunHeld(
                "cooling_timeout", f"after {recipe.cooling_timeout_s:.0f} s the difference is still {difference:.1f} K"
            )
        await run.checkpoint()
        await asyncio.sleep(LOOK_S)


async def _require_nuts(run: RunContext) -> None:
    needed = run.recipe.pattern.count
    if run.recipe.tighten.nut_supply == "hand_started":
        await run.checkpoint(ask=f"start {needed} nuts by hand, two turns each, count them and confirm")
        await run.ledger.note("nuts_confirmed", {"count": needed})
        return
    count = await run.devices.nut_feeder.count()
    if count < needed:
        raise RunHeld("nuts_missing", f"the magazine holds {count} nuts, {needed} are needed")


async def _check_drift(run: RunContext, at_start: AxesPosition) -> float:
    """How far the reaction of the guns has turned the shaft's table."""
    drift = abs((await shaft_axes(run.devices)).theta_deg - at_start.theta_deg)
    gate = run.recipe.tighten.drift_gate_deg
    if not drift <= gate:
        raise RunHeld("shaft_drift", f"the shaft turned by {drift:.3f} deg during tightening (limit {gate} deg)")
    return drift
