"""Whole assemblies over the devices' own protocols: simulators and controller in one process, on a quickened loop."""

from __future__ import annotations

import asyncio
import socket
from contextlib import ExitStack
from functools import cache, partial
from pathlib import Path
from typing import Any

from cellctl.gun_programs import programs_of
from cellctl.recipe import Recipe
from cellctl.runner import Outcome, RunRequest, run_here
from cellctl.twin import twin_of
from hal.clock import QuickenedLoop
from hal.config import CellConfig, load_cell
from hal.fake.truth import Truth, truth_of
from hal.fake.wire.stand import standing
from tests.journeys.twin_runs import FINE_CAMERA, POINTS, ROOT, RememberedJobs

CELL = ROOT / "deploy" / "cell.wire.toml"
SPEED = 400.0
CATCH_UP_S = 0.002
"""Loop time that one busy moment of the machine may cost: an exchange within its deadline stays so."""


def wire_cell(folder: Path, **numbers: Any) -> CellConfig:
    """The wire cell at free ports of this machine, its files below `folder`, behind a fine camera, its guard in the
    loop: a process of its own has a clock that cannot be quickened.

    `numbers` replace those keys of every entry that has them.
    """
    config = load_cell(CELL)
    ports = free_ports()
    devices = {}
    for name, entry in config.entries.items():
        changes = {key: value for key, value in numbers.items() if key in type(entry).model_fields}
        if "port" in type(entry).model_fields:
            changes["port"] = ports(entry.port)
        devices[name] = entry.model_copy(update=changes)
    assert config.can is not None
    can = config.can.model_copy(update={"channel": f"socket://127.0.0.1:{ports(4401)}"})
    calibration = config.calibration.model_copy(update={"file": config.calibration_path.resolve()})
    twin = config.twin.model_copy(update={"points": POINTS, "overrides": FINE_CAMERA})
    return config.model_copy(
        update={
            "devices": config.devices.model_copy(update=devices),
            "can": can,
            "guard": config.guard.model_copy(update={"process": "in_loop"}),
            "calibration": calibration,
            "twin": twin,
            "path": folder / "deploy" / CELL.name,
        }
    )


def free_ports() -> Any:
    """A free port for each port of the cell file, the same one for the same."""

    @cache
    def free(port: int) -> int:
        with ExitStack() as stack:
            found = stack.enter_context(socket.socket())
            found.bind(("127.0.0.1", 0))
            return int(found.getsockname()[1])

    return free


def assembled_over_the_wire(recipe: Recipe, config: CellConfig, data: Path, *, seed: int = 1) -> tuple[Outcome, Truth]:
    """One run to its end, and what the plant's owner knows of it."""

    async def main() -> tuple[Outcome, Truth]:
        jobs = RememberedJobs()
        twin = twin_of(recipe, config, jobs, seed=seed)
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)):
            outcome = await run_here(RunRequest(recipe, config, seed, data, keep="none", jobs=jobs))
        return outcome, truth_of(twin.plant)

    with asyncio.Runner(loop_factory=partial(QuickenedLoop, SPEED, CATCH_UP_S)) as runner:
        return runner.run(main())
