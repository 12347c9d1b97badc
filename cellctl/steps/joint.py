"""One pair of joints: programs for the guns, results taken in, each result counted once."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from cellctl.ports import RunContext
from cellctl.recipe import Stage, Tighten
from cellctl.steps.order import Pair
from cellctl.steps.results import JointResult
from cellctl.steps.together import together
from hal.errors import UnknownOutcome
from hal.interfaces import Band, Gun, TighteningProgram, TighteningResult


def stage_program(recipe: Tighten, stage: Stage) -> TighteningProgram:
    """The gun's program for one stage."""
    return TighteningProgram(
        stage=stage.name,
        target_torque_nm=stage.torque_nm,
        torque_low_nm=stage.torque_nm * (1 - stage.torque_tolerance),
        torque_high_nm=stage.torque_nm * (1 + stage.torque_tolerance),
        angle_low_deg=stage.angle_low_deg,
        angle_high_deg=stage.angle_high_deg,
        threshold_torque_nm=recipe.snug_threshold_nm,
        speed_rpm=stage.speed_rpm,
        timeout_s=recipe.timeout_s,
    )


def verify_program(recipe: Tighten) -> TighteningProgram:
    """Below the final torque a tight nut must hardly turn: it reaches the torque within a small angle.

    Slow, because the torque of a standing nut rises within milliseconds; the final torque itself is never passed.
    """
    final = recipe.stages[-1]
    torque = recipe.verify_fraction * final.torque_nm
    return TighteningProgram(
        stage="verify",
        target_torque_nm=torque,
        torque_low_nm=torque * (1 - final.torque_tolerance),
        torque_high_nm=final.torque_nm,
        angle_low_deg=0.0,
        angle_high_deg=recipe.verify_angle_high_deg,
        threshold_torque_nm=recipe.snug_threshold_nm,
        speed_rpm=min(final.speed_rpm, recipe.engage.turn_speed_rpm),
        timeout_s=recipe.timeout_s,
    )


async def run_down(
    run: RunContext, pair: Pair, program: TighteningProgram, tries: tuple[int, int]
) -> tuple[JointResult, JointResult]:
    """Both guns at once on one pair. A result that does not come is asked for once, never tightened for again."""
    return await together(
        _one(run, "a", run.devices.gun_a, pair.a, program, tries[0]),
        _one(run, "b", run.devices.gun_b, pair.b, program, tries[1]),
    )


async def _one(
    run: RunContext, name: Literal["a", "b"], gun: Gun, index: int, program: TighteningProgram, tries: int
) -> JointResult:
    used = ""

    async def command(key: str) -> TighteningResult:
        nonlocal used
        used = key
        return await gun.tighten(key, program)

    result: TighteningResult | None
    try:
        result = await run.ledger.act(f"gun_{name}", "tighten", {"joint": index, "program": program}, command)
    except UnknownOutcome:
        result = None
    if result is None or result.key != used:  # lost, or an old result told again
        result = await run.ledger.act(f"gun_{name}", "result", {"key": used}, lambda key: gun.result(used))
    if result is None:
        return _unknown(name, index, program, tries)
    trace = await run.ledger.blob(
        f"trace_{index}_{program.stage}",
        {"time_s": result.trace.time_s, "angle_deg": result.trace.angle_deg, "torque_nm": result.trace.torque_nm},
    )
    peak_nm = float(np.max(result.trace.torque_nm, initial=0.0))
    return JointResult(
        index=index,
        gun=name,
        stage=program.stage,
        torque_nm=result.torque_nm,
        angle_deg=result.angle_deg,
        target_torque_nm=program.target_torque_nm,
        torque_low_nm=program.torque_low_nm,
        torque_high_nm=program.torque_high_nm,
        torque_band=result.torque_band,
        angle_band=result.angle_band,
        trace_peak_nm=peak_nm,
        verdict="ok" if _within(result, peak_nm, program) else "nok",
        tightening_id=result.tightening_id,
        trace=trace,
        engage_tries=tries,
    )


def _within(result: TighteningResult, peak_nm: float, program: TighteningProgram) -> bool:
    """The gun's own word, its trace and the windows, recomputed: all must agree that the joint is tight."""
    return (
        result.ok
        and program.torque_low_nm <= result.torque_nm <= program.torque_high_nm
        and program.torque_low_nm <= peak_nm <= program.torque_high_nm
        and program.angle_low_deg <= result.angle_deg <= program.angle_high_deg
    )


def _unknown(name: Literal["a", "b"], index: int, program: TighteningProgram, tries: int) -> JointResult:
    return JointResult(
        index=index,
        gun=name,
        stage=program.stage,
        torque_nm=math.nan,
        angle_deg=math.nan,
        target_torque_nm=program.target_torque_nm,
        torque_low_nm=program.torque_low_nm,
        torque_high_nm=program.torque_high_nm,
        torque_band=Band.LOW,
        angle_band=Band.LOW,
        trace_peak_nm=math.nan,
        verdict="unknown",
        tightening_id=0,
        trace="",
        engage_tries=tries,
    )
