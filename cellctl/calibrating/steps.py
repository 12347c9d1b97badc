"""The three procedures as a technician sees them: what is presented, where everything goes, what is read there.

Each returns what the pure functions made of it. Raises Refused, CellError.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cellctl.calibrating.camera import ViewPose, view_pose
from cellctl.calibrating.force import Force, Weighed, force_gain
from cellctl.calibrating.jack import JackLine, Probed, centre_of, jack_line
from cellctl.calibrating.stand import (
    Stand,
    camera_to,
    capture,
    guarded_jack,
    move,
    prepare,
    present,
    probes,
    weigh,
    where,
)
from cellctl.calibrating.table import Seen, StageAxes, TableAxis, seen_part, stage_axes, table_axis
from cellctl.kinematics import AxesPosition
from cellctl.steps.motion import axis
from cellctl.steps.scan import RETAKEN, Side
from cellctl.vision.measure import Gates, measure_part
from cellctl.vision.part import Part, PartMeasurement, Refused
from cellctl.vision.spheres import sphere_fits
from hal.units import GRAVITY_M_S2

NOTHING, MANDREL, WEIGHT = "-", "CAL-MANDREL", "CAL-WEIGHT-"
"""Serial numbers of what goes into the cell in place of parts; a weight's has its mass in kilograms behind it."""
VISION_S = 0.8
RETAKES = 2
ANGLES = 12
TURN_DEG = 330.0
STEPS_MM = (-8.0, 0.0, 8.0, 4.0, -4.0)
"""Stops of the stage along each axis, arrived at from both sides."""
REVERSAL_DEG = (-90.0, 90.0)
PROBE_STEPS_MM = (-0.4, 0.4, 0.0)
WANDERED_MM = 0.2
WEIGH_AT_MM = 5.0
LOADS = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Shares of the sensor's range."""


@dataclass(frozen=True, slots=True)
class CameraStops:
    """How often each view is looked at."""

    looks: int = 6


@dataclass(frozen=True, slots=True)
class AxesStops:
    """The part that the table carries, its quality gates, and the path of the jack; `mandrel_mm` is its diameter."""

    part: Part
    gates: Gates
    top_mm: float
    heights: int = 9
    mandrel_mm: float = 80.0


async def camera(stand: Stand, stops: CameraStops) -> dict[Side, ViewPose]:
    """The artefact seen in both views."""
    await prepare(stand)
    await present(stand, stand.rotor, stand.shaft)
    found: dict[Side, ViewPose] = {}
    artefact = stand.calibration.artefact
    for side in ("rotor", "shaft"):
        await camera_to(stand, side)
        start = stand.calibration.views[side].matrix
        certified = np.array(artefact.rotor_side_mm if side == "rotor" else artefact.shaft_side_mm)
        looks = []
        for look in range(stops.looks):
            stand.tell(f"artefact in the {side} view, look {look + 1} of {stops.looks}")
            frame = await capture(stand, "artefact_rotor" if side == "rotor" else "artefact_shaft")
            asked = (frame.points_mm, start, certified, artefact.sphere_diameter_mm)
            looks.append(await stand.jobs.run(sphere_fits, *asked, latency_s=VISION_S))
        found[side] = view_pose(
            looks,
            certified,
            start,
            stand.calibration.scanner,
            sphere_diameter_mm=artefact.sphere_diameter_mm,
            certificate_mm=artefact.sigma_mm,
        )
    await camera_to(stand, "parked")
    return found


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
    probed = await _stroke(stand, stops)
    directions = (stage.x_direction, stage.y_direction)
    return table, stage, jack_line(probed, directions, table, radius_mm=0.5 * stops.mandrel_mm)


def spread_masses(range_n: float) -> tuple[float, ...]:
    """Round masses (kg) that spread over a sensor's range and stay inside it with a gain a tenth off."""
    whole_kg = range_n / GRAVITY_M_S2
    step_kg = 10.0 ** (math.floor(math.log10(whole_kg)) - 1)
    return tuple(math.floor(share * whole_kg / step_kg) * step_kg for share in LOADS)


async def force(stand: Stand, masses_kg: Sequence[float], mass_sigma: float, range_n: float) -> Force:
    """Weights hung on the sensor."""
    await prepare(stand)
    weighed: list[Weighed] = []
    for mass in masses_kg:
        await present(stand, NOTHING, f"{WEIGHT}{mass:g}")
        stand.tell(f"weighing {mass:g} kg")
        weighed.append(await weigh(stand, mass, WEIGH_AT_MM))
        await move(stand, "jack", 0.0)
    return force_gain(weighed, range_n=range_n, mass_sigma=mass_sigma)


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


async def _stroke(stand: Stand, stops: AxesStops) -> list[Probed]:
    """The mandrel past the probes: the stage stepped below, then the whole stroke at two angles half a turn apart."""
    await present(stand, NOTHING, MANDREL)
    probed = []
    for turn in REVERSAL_DEG:
        await move(stand, "shaft_table", turn)
        middle = await _centred(stand, Probed(await where(stand), await probes(stand)))
        for name in ("stage_x", "stage_y"):
            for step in PROBE_STEPS_MM:
                await move(stand, name, (middle.x_mm if name == "stage_x" else middle.y_mm) + step)
                probed.append(Probed(await where(stand), await probes(stand)))
        for height in np.linspace(0.0, stops.top_mm, stops.heights)[1:]:
            stand.tell(f"mandrel at table {turn:g} deg, jack {height:.0f} mm")
            await guarded_jack(stand, float(height))
            probed.append(Probed(await where(stand), await probes(stand)))
            await _centred(stand, probed[-1])
        await guarded_jack(stand, 0.0)
    return probed


async def _centred(stand: Stand, last: Probed) -> AxesPosition:
    """Bring a mandrel that has wandered off back to the middle of the probes, before it leaves their range."""
    aside = centre_of(last.gap_mm)
    if np.hypot(*aside) > WANDERED_MM and last.at.z_mm <= stand.free_mm:
        await move(stand, "stage_x", last.at.x_mm - float(aside[0]))
        await move(stand, "stage_y", last.at.y_mm - float(aside[1]))
    return await where(stand)
