"""`cellctl simulate`: the device simulators of a wire cell with the twin behind them, until Ctrl-C."""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellctl.recipe import Recipe, load_recipe
from cellctl.signals import ending
from hal.addresses import buses
from hal.config import CellConfig, load_cell
from hal.errors import ConfigError
from hal.priority import real_time

if TYPE_CHECKING:
    from hal.fake.faults import Fault

REAL_TIME = 10
"""Devices do not wait for a busy desk."""


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser("simulate", help="the devices of a wire cell, on this desk")
    parser.add_argument("--cell", type=Path, required=True, help="cell file (TOML)")
    parser.add_argument("--recipe", type=Path, required=True, help="the parts on the bench and the guns' programs")
    parser.add_argument("--seed", type=int, help="the twin's; default: the cell file's")
    parser.add_argument(
        "--faults", type=Path, help="fault file; phases are not known here, only seconds from the start"
    )
    parser.add_argument("--truth", type=Path, metavar="DIR", help="write here how each pair of parts really stands")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 at Ctrl-C, 2 for a file or an address that does not fit."""
    from hal.fake.fault_file import load_faults

    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        config, recipe = load_cell(args.cell), load_recipe(args.recipe)
        seed = config.twin.seed if args.seed is None else args.seed
        faults = load_faults(args.faults).faults if args.faults else ()
        asyncio.run(simulate(config, recipe, seed, faults, args.truth))
    except (ConfigError, OSError) as error:
        print(f"cellctl: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


async def simulate(
    config: CellConfig, recipe: Recipe, seed: int, faults: tuple[Fault, ...], truth: Path | None = None
) -> None:
    """Until Ctrl-C or SIGTERM. What is true of the parts is kept in folder `truth`. Raises ConfigError, OSError."""
    # Slow to import, and not needed to say what is wrong with the files.
    from cellctl.gun_programs import programs_of
    from cellctl.truth_files import keeping_truth
    from cellctl.twin import RENDERING, truth_limits, twin_of
    from hal.fake.wire.stand import standing
    from hal.jobs import ProcessJobs

    now = asyncio.get_running_loop().time()
    async with ProcessJobs(modules=RENDERING) as jobs:
        twin = twin_of(recipe, config, jobs, seed=seed, faults=from_now(faults, now), now=now)
        async with (
            standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)),
            keeping_truth(truth, twin.plant, truth_limits(recipe)),
        ):
            for where, names in buses(config).items():
                print(f"{where:40} {', '.join(names)}")
            print(f"twin of {recipe.recipe.id}, seed {seed}, level {config.twin.level}; Ctrl-C ends", flush=True)
            real_time(REAL_TIME)
            ended = asyncio.Event()
            with ending(ended.set):
                await ended.wait()


def from_now(faults: tuple[Fault, ...], now: float) -> tuple[Fault, ...]:
    """Faults at seconds from the start, on this machine's clock."""
    return tuple(replace(fault, at_s=fault.at_s + now) for fault in faults)
