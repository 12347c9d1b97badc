"""Phase scan: parts presented and clamped, axes homed, artefact checked, both parts measured."""

from __future__ import annotations

import asyncio
from typing import Literal

import numpy as np

from cellctl.ports import RunContext, RunHeld
from cellctl.steps.motion import (
    AXES,
    IN_THE_WAY,
    camera_to,
    home,
    move,
    require_clamped,
    require_safety,
    shaft_axes,
)
from cellctl.steps.results import Scans
from cellctl.steps.together import all_together
from cellctl.vision.part import PartMeasurement, Refused
from hal.interfaces import Frame, View

Side = Literal["rotor", "shaft"]
RETAKEN = frozenset({"too_few_points", "features_missing", "too_noisy", "face_not_found", "pattern_ambiguous"})
"""Refusals that another look may cure; every other one speaks of the part or of the scanner itself."""


async def prepare(run: RunContext) -> None:
    """Ready for the first look: safe, parts known by their serials, clamped, homed, everything at its start."""
    await require_safety(run)
    for name in IN_THE_WAY:
        await home(run, name)
    await all_together(*(home(run, name) for name in AXES if name not in IN_THE_WAY))
    await move(run, "gun_feed", 0.0)
    await move(run, "jack", 0.0)
    await _present(run)
    await run.ledger.act("chuck", "clamp", {}, lambda key: run.devices.chuck.clamp())
    await require_clamped(run)


async def scan(run: RunContext) -> Scans:
    """Both parts in the cell frame. Raises RunHeld when the bench has moved or no scan is good enough."""
    run.progress.report("scan", 0.1, "checking the artefact from both camera poses")
    residual = max([await check_artefact(run, side) for side in ("rotor", "shaft")])
    await run.checkpoint()
    run.progress.report("scan", 0.4, "measuring the rotor")
    rotor = await measure(run, "rotor")
    await run.checkpoint()
    run.progress.report("scan", 0.7, "measuring the shaft")
    at = await shaft_axes(run.devices)
    shaft = await measure(run, "shaft")
    return Scans(rotor=rotor, shaft=shaft, shaft_at=at, artefact_residual_mm=residual)


async def check_artefact(run: RunContext, side: Side) -> float:
    """Largest residual (mm) of the artefact's spheres; beyond the gate the frame may not be trusted."""
    await camera_to(run, side)
    try:
        residuals = await run.vision.artefact(
            await _capture(run, "artefact_rotor" if side == "rotor" else "artefact_shaft")
        )
    except Refused as refusal:
        raise RunHeld(refusal.code, refusal.reason) from refusal
    await run.ledger.note("artefact", {"side": side, "residuals_mm": residuals})
    worst = float(np.linalg.norm(residuals, axis=1).max())
    gate = run.recipe.scan.artefact_gate_mm
    if not worst <= gate:
        raise RunHeld(
            "artefact_moved",
            f"the artefact is off by {worst:.3f} mm in the {side} view (limit {gate} mm): camera or bench has moved",
        )
    return worst


async def measure(run: RunContext, side: Side) -> PartMeasurement:
    """One part in the cell frame; a refused scan is taken again a bounded number of times, then the run is held."""
    await camera_to(run, side)
    part = run.recipe.part(side)
    refusal: Refused | None = None
    for attempt in range(run.recipe.scan.max_retakes + 1):
        frame = await _capture(run, side)
        try:
            measurement = await run.vision.measure(frame, part)
            _require_features(measurement)
        except Refused as error:
            refusal = error
            await run.ledger.note(
                "scan_refused", {"side": side, "attempt": attempt, "code": error.code, "reason": error.reason}
            )
            if error.code not in RETAKEN:
                break
            continue
        pose = run.calibration.views[side].matrix
        value = {"side": side, "frame_id": frame.frame_id, "T_cell_scanner": pose, "measurement": measurement}
        await run.ledger.note("measurement", value)
        return measurement
    assert refusal is not None
    raise RunHeld(refusal.code, f"no good scan of the {side}: {refusal.reason}") from refusal


def _require_features(measurement: PartMeasurement) -> None:
    if missing := [feature.index for feature in measurement.features if not feature.found]:
        raise Refused("features_missing", f"features {missing} are not found")


async def _capture(run: RunContext, view: View) -> Frame:
    """A frame of this very view, taken after the command. Its cloud is stored by the ledger, by content hash."""
    asked_at_s = asyncio.get_running_loop().time()
    frame = await run.ledger.act("scanner", "capture", {"view": view}, lambda key: run.devices.scanner.capture(view))
    if frame.view != view or frame.time_s < asked_at_s:
        raise RunHeld(
            "old_frame",
            f"the scanner gave frame {frame.frame_id} of view {frame.view}, {asked_at_s - frame.time_s:.1f} s old, "
            f"when asked for {view}",
        )
    return frame


async def _present(run: RunContext) -> None:
    wanted = (run.rotor_serial, run.shaft_serial)
    read = await run.ledger.act(
        "part_station",
        "present",
        {"rotor": wanted[0], "shaft": wanted[1]},
        lambda key: run.devices.part_station.present(*wanted),
    )
    if tuple(read) != wanted:
        raise RunHeld(
            "wrong_serial", f"parts {read[0]} and {read[1]} are in the cell, ordered were {wanted[0]} and {wanted[1]}"
        )
