"""Procedure axes: table turned and stage stepped under the camera, then the jack. Raises Refused, CellError."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from cellctl.calibrating.jack import JackLine, jack_line
from cellctl.calibrating.seen import Seen, seen_part
from cellctl.calibrating.stage import StageAxes, stage_axes
from cellctl.calibrating.stand import VISION_S, Stand, camera_to, capture, move, prepare, present, where
from cellctl.calibrating.stroke import HEIGHTS, stroke
from cellctl.calibrating.table import TableAxis, table_axis
from cellctl.steps.motion import axis
from cellctl.steps.scan import RETAKEN
from cellctl.vision.measure import Gates, measure_part
from cellctl.vision.part import Part, PartMeasurement, Refused

RETAKES = 2
ANGLES = 12
TURN_DEG = 330.0
STEPS_MM = (-8.0, 0.0, 8.0, 4.0, -4.0)
"""Stops of the stage along each axis, arrived at from both sides."""
STOPS = ANGLES + 2 * len(STEPS_MM) + 2 * HEIGHTS


@dataclass(frozen=True, slots=True)
class AxesStops:
    """The part that the table carries, its quality gates, and how high the jack goes; the mandrel's diameter."""

    part: Part
    gates: Gates
    top_mm: float
    mandrel_mm: float


async def axes(stand: Stand, stops: AxesStops) -> tuple[TableAxis, StageAxes, JackLine]:
    """Table turned and stage stepped under the camera, then the jack over its stroke past the probes."""
    await prepare(stand)
    await present(stand, stand.rotor, stand.shaft)
    await _to_start(stand)
    await camera_to(stand, "shaft")
    limits = axis(stand.devices, "shaft_table").limits
    low, high = max(limits.low, -0.5 * TURN_DEG), min(limits.high, 0.5 * TURN_DEG)
    turned = [await _seen_at(stand, stops, 0.0, 0.0, float(turn)) for turn in np.linspace(low, high, ANGLES)]
    stepped = [await _seen_at(stand, stops, step, 0.0, 0.0) for step in STEPS_MM]
    stepped += [await _seen_at(stand, stops, 0.0, step, 0.0) for step in STEPS_MM]
    view = stand.calibration.views["shaft"]
    errors = view.errors()
    covariance = errors @ errors.T
    radius = 0.25 * ((stops.part.face_inner_diameter_mm or 0.0) + (stops.part.face_outer_diameter_mm or 0.0))
    ripple = (stand.calibration.scanner.sigma_ripple_mm, radius or 0.5 * stops.part.circle_diameter_mm)
    table = table_axis(turned, (view.matrix[:3, 3], covariance), ripple)
    stage = stage_axes(stepped, covariance)
    await _to_start(stand)
    await camera_to(stand, "parked")
    probed = await stroke(stand, stops.top_mm)
    directions = (stage.x_direction, stage.y_direction)
    return table, stage, jack_line(probed, directions, table, radius_mm=0.5 * stops.mandrel_mm)


async def _to_start(stand: Stand) -> None:
    for name in ("stage_x", "stage_y", "shaft_table"):
        await move(stand, name, 0.0)


async def _seen_at(stand: Stand, stops: AxesStops, x_mm: float, y_mm: float, theta_deg: float) -> Seen:
    await move(stand, "stage_x", x_mm)
    await move(stand, "stage_y", y_mm)
    await move(stand, "shaft_table", theta_deg)
    stand.tell(f"part at x {x_mm:g} mm, y {y_mm:g} mm, table {theta_deg:.0f} deg")
    part = await _measured(stand, stops)
    return seen_part(part, await where(stand), stops.part.angles_deg)


async def _measured(stand: Stand, stops: AxesStops) -> PartMeasurement:
    """The part in the shaft view; a refused scan is taken again a bounded number of times."""
    pose, measure = stand.calibration.views["shaft"].matrix, partial(measure_part, gates=stops.gates)
    for attempt in range(RETAKES + 1):
        frame = await capture(stand, "shaft")
        try:
            return await stand.jobs.run(measure, frame.points_mm, stops.part, pose, latency_s=VISION_S)
        except Refused as refusal:
            if refusal.code not in RETAKEN or attempt == RETAKES:
                raise
    raise AssertionError("the loop returns or raises")
