"""Phase align: scan, move, scan again, until residual plus uncertainty is inside the gate, in bounded tries."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace

import numpy as np

from cellctl.docking import Alignment, align_spec
from cellctl.kinematics import AxesPosition, shaft_at
from cellctl.ports import RunContext, RunHeld
from cellctl.recipe import Recipe
from cellctl.steps.motion import move, shaft_axes
from cellctl.steps.results import Aligned, Scans
from cellctl.steps.scan import measure
from cellctl.vision.part import PartMeasurement, Refused


async def align_shaft(run: RunContext, scans: Scans) -> Aligned:
    """Bring the shaft under the rotor. Raises RunHeld when a gate is not met within the recipe's loops."""
    shaft, at = scans.shaft, scans.shaft_at
    alignment = await _compute(run, scans.rotor, shaft, at)
    first = alignment
    loops = run.recipe.align.max_loops
    for loop in range(1, loops + 1):
        run.progress.report("align", loop / (loops + 1), f"moving by {_motion(alignment)}, then scanning again")
        await run.checkpoint()
        target = replace(alignment.target, z_mm=at.z_mm)
        expected = shaft_at(run.calibration, shaft.T_frame_part, at, target)
        await move(run, "stage_x", target.x_mm)
        await move(run, "stage_y", target.y_mm)
        await move(run, "shaft_table", target.theta_deg)
        at = await shaft_axes(run.devices)
        shaft = await measure(run, "shaft")
        await _check_motion(run, expected, shaft)
        alignment = await _compute(run, scans.rotor, shaft, at)
        if inside_gates(run.recipe, alignment):
            _check_odds(run.recipe, alignment)
            expires = asyncio.get_running_loop().time() + run.recipe.align.expires_s
            return Aligned(alignment=alignment, shaft=shaft, loops=loop, first=first, expires_at_s=expires)
    raise RunHeld("alignment_not_reached", f"after {loops} loops still {_motion(alignment)} to go")


def inside_gates(recipe: Recipe, alignment: Alignment) -> bool:
    """Whether what is left to move, plus its uncertainty times the coverage factor, is inside the gates."""
    gates = recipe.align
    left_mm = math.hypot(alignment.x_mm, alignment.y_mm) + gates.coverage_factor * alignment.sigma_xy_mm
    left_deg = abs(alignment.theta_deg) + gates.coverage_factor * alignment.sigma_theta_deg
    return left_mm <= gates.gate_xy_mm and left_deg <= gates.gate_theta_deg


async def _compute(run: RunContext, rotor: PartMeasurement, shaft: PartMeasurement, at: AxesPosition) -> Alignment:
    try:
        travel = run.devices.shaft_table.limits
        spec = align_spec(run.recipe, theta_low_deg=travel.low, theta_high_deg=travel.high)
        alignment = await run.vision.align(rotor, shaft, at, spec)
    except Refused as refusal:
        raise RunHeld(refusal.code, refusal.reason) from refusal
    await run.ledger.note("alignment", alignment)
    if alignment.tilt_deg > run.recipe.align.gate_tilt_deg:
        raise RunHeld(
            "tilt_beyond_gate",
            f"the faces are tilted by {alignment.tilt_deg:.3f} deg (limit {run.recipe.align.gate_tilt_deg} deg), "
            "which no axis can correct",
        )
    return alignment


async def _check_motion(run: RunContext, expected: np.ndarray, shaft: PartMeasurement) -> None:
    """The part must be where the calibrated kinematics said, or the calibration is not of this cell."""
    miss = float(np.linalg.norm(shaft.T_frame_part[:3, 3] - expected[:3, 3]))
    await run.ledger.note("motion_residual", {"miss_mm": miss})
    gate = run.recipe.align.motion_gate_mm
    if miss > gate:
        raise RunHeld(
            "motion_residual", f"after the motion the shaft is {miss:.3f} mm from where it should be (limit {gate} mm)"
        )


def _check_odds(recipe: Recipe, alignment: Alignment) -> None:
    odds, needed = alignment.p_force_ok, recipe.align.min_p_insert
    if odds < needed:
        raise RunHeld(
            "insertion_improbable",
            f"all studs enter below {recipe.jack_up.force_limit_n} N with a probability of {odds:.3f} "
            f"(needed {needed})",
        )


def _motion(alignment: Alignment) -> str:
    return f"x {alignment.x_mm:+.3f} mm, y {alignment.y_mm:+.3f} mm, theta {alignment.theta_deg:+.4f} deg"
