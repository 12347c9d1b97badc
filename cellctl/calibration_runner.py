"""One procedure of calibration on one cell: the composition root of `cellctl calibrate`.

Fakes run in virtual time with their twin behind them, real devices in their own. Whatever happens, the cell is made
safe and closed at the end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from cellctl.calibrated_devices import told
from cellctl.calibrating.entry import Part, put_in, require_same_devices
from cellctl.calibrating.hang import force, spread_masses
from cellctl.calibrating.look import camera
from cellctl.calibrating.outcome import of_axes, of_camera, of_force
from cellctl.calibrating.stand import Stand
from cellctl.calibrating.travel import STOPS, AxesStops, axes
from cellctl.calibration import Calibration, Procedure
from cellctl.recipe import Recipe
from cellctl.scan_gates import gates_of
from cellctl.service_rules import real_devices
from cellctl.stamps import Stamps, VirtualStamps, WallStamps
from cellctl.twin import standing_cell
from cellctl.vision.worker import WARM
from hal.cell import Cell
from hal.clock import run_virtual
from hal.config import CellConfig
from hal.jobs import InlineJobs, Jobs, ProcessJobs
from hal.owner import sole_user

USED: dict[Procedure, tuple[str, ...]] = {
    "camera": ("scanner", "camera_park"),
    "axes": ("scanner", "shaft_table", "stage_x", "stage_y", "jack", "gap_probe_1", "gap_probe_2", "gap_probe_3"),
    "force": ("jack_force", "jack"),
}
"""The devices that the result of each procedure is of."""


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """What is to be calibrated, from which file on. `recipe` says which parts are used and what the twin is built to.

    `masses_kg` empty: weights that spread over the sensor's range. `valid_days` None: as long as the file before.
    """

    procedure: Procedure
    config: CellConfig
    base: Calibration
    recipe: Recipe
    seed: int
    masses_kg: tuple[float, ...] = ()
    mass_sigma: float = 3e-5
    looks: int = 6
    mandrel_mm: float = 80.0
    valid_days: float | None = None
    rotor_serial: str = "R-1"
    shaft_serial: str = "S-1"
    tell: Callable[[str], None] = lambda _: None


def calibrate_once(request: CalibrationRequest) -> Calibration:
    """The calibration with the new part. Raises Refused, RunHeld, CellError, and ConfigError for the files."""
    if real_devices(request.config):
        return asyncio.run(_in_real_time(request))
    return run_virtual(calibrate_here(request, InlineJobs()))


async def _in_real_time(request: CalibrationRequest) -> Calibration:
    with sole_user(request.config.path):
        async with ProcessJobs(modules=WARM) as jobs:
            return await calibrate_here(request, jobs)


async def calibrate_here(request: CalibrationRequest, jobs: Jobs) -> Calibration:
    """As `calibrate_once`, on the loop that runs already."""
    config = request.config
    stamps: Stamps = WallStamps() if real_devices(config) else VirtualStamps(request.seed)
    started = stamps.now()
    cell = standing_cell(request.recipe, config, jobs, seed=request.seed).cell
    try:
        devices = await cell.connect()
        require_same_devices(request.base, request.procedure, devices)
        await cell.rearm()
        part = await _procedure(request, cell, jobs)
    finally:
        await cell.make_safe(config.cell.safe_deadline_s, "the calibration has ended")
        await cell.close()
    return put_in(
        request.base,
        part,
        name=config.cell.name,
        started=started,
        until=_until(started, request.valid_days),
        devices={name: told(devices[name]) for name in USED[request.procedure]},
    )


async def _procedure(request: CalibrationRequest, cell: Cell, jobs: Jobs) -> Part:
    config, base = request.config, request.base
    stand = Stand(
        devices=cell,
        interlock=cell.guard,
        jobs=jobs,
        calibration=base,
        guard=config.guard,
        tell=request.tell,
        rotor=request.rotor_serial,
        shaft=request.shaft_serial,
        free_mm=config.envelope.free_mm,
    )
    match request.procedure:
        case "camera":
            poses = await camera(stand, request.looks)
            return of_camera(base, poses, request.looks)
        case "axes":
            top = min(config.cell.rotor_face_mm, config.devices.jack.high)
            stops = AxesStops(request.recipe.part("shaft"), gates_of(request.recipe), top, request.mandrel_mm)
            table, stage, jack = await axes(stand, stops)
            return of_axes(base, table, stage, jack, STOPS)
        case "force":
            masses = request.masses_kg or spread_masses(cell.jack_force.range_n)
            found = await force(stand, masses, request.mass_sigma, cell.jack_force.range_n)
            return of_force(found, len(masses))


def base_path(config: CellConfig, given: Path | None, output: Path) -> Path:
    """The file to go on from: the one given, else the output where it is there already, else the cell's own."""
    if given is not None:
        return given
    return output if output.exists() else config.calibration_path


def _until(started: datetime, days: float | None) -> datetime | None:
    return None if days is None else started + timedelta(days=days)
