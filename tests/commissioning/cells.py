"""Cells for a technician: on fakes under virtual time, and on the wire on a quickened loop."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from cellctl.twin import FakeCell, fake_cell, twin_of
from hal.clock import run_virtual
from hal.config import CellConfig, load_cell
from hal.fake.fault_file import Fault
from hal.fake.wire.stand import Stand, standing
from hal.jobs import InlineJobs
from tests.contract.backends import alone, quickened
from tests.journeys.twin_runs import CELL, RECIPE
from tests.journeys.wire_runs import CATCH_UP_S, wire_cell

CONFIG = load_cell(CELL)
BRISK = {"pdo_s": 1.0, "heartbeat_s": 1.0, "rate_hz": 100.0}
"""Fewer messages than in a hall, for a loop that is to run fast."""
HOMING = ("gun_feed", "gun_table", "jack", "stage_x", "stage_y", "shaft_table")
SEED = 1


def on_fakes(case: Callable[[FakeCell], Awaitable[None]], *faults: Fault, home: bool = False) -> None:
    """Run `case` on a cell of fakes, its axes homed where they are to be; closed in the end."""

    async def main() -> None:
        fake = fake_cell(load_recipe(RECIPE), CONFIG, InlineJobs(), seed=SEED, faults=faults)
        try:
            if home:
                await fake.cell.connect()
                for name in HOMING:
                    await getattr(fake.cell, name).home()
            await case(fake)
        finally:
            await fake.cell.close()

    run_virtual(alone(main()))


def on_wires(folder: Path, case: Callable[[CellConfig, Stand], Awaitable[None]], speed: float = 20.0) -> None:
    """Run `case` beside the simulators of a whole wire cell; no task may be left."""

    async def main() -> None:
        config, recipe = wire_cell(folder, **BRISK), load_recipe(RECIPE)
        twin = twin_of(recipe, config, InlineJobs(), seed=SEED)
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)) as stand:
            await case(config, stand)

    quickened(main(), speed, CATCH_UP_S)
