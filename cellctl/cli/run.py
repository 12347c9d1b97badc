"""`cellctl run`: one assembly in virtual time, without the API."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from cellctl.recipe import load_recipe
from cellctl.recipe_checks import CHECK_NAMES
from hal.config import load_cell
from hal.errors import ConfigError, DeviceRefused

EXIT = {"accepted": 0, "rejected": 3, "held": 3}


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser("run", help="one assembly in virtual time")
    parser.add_argument("--recipe", type=Path, required=True)
    parser.add_argument("--cell", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=None, help="default: the cell file's")
    parser.add_argument("--level", choices=("ideal", "nominal", "hostile"))
    parser.add_argument("--points", type=points_of, help="pixels of a cloud; default: the cell file's")
    parser.add_argument("--faults", type=Path, help="fault file")
    parser.add_argument("--force", action="append", default=[], choices=CHECK_NAMES, metavar="CHECK")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a number of the twin")
    parser.add_argument("--keep", choices=("all", "decision", "none"), default="decision")
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 accepted, 3 rejected, held, or not begun because the devices are in other hands, 2 bad input."""
    from cellctl.runner import RunRequest, run_once, with_twin
    from hal.fake.fault_file import load_faults

    try:
        config = with_twin(load_cell(args.cell), level=args.level, points=args.points, overrides=numbers_of(args.set))
        request = RunRequest(
            recipe=load_recipe(args.recipe),
            config=config,
            seed=config.twin.seed if args.seed is None else args.seed,
            data=args.data,
            faults=load_faults(args.faults).faults if args.faults else (),
            forced=tuple(args.force),
            keep=args.keep,
        )
        outcome = run_once(request)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except DeviceRefused as error:
        print(error, file=sys.stderr)
        return 3
    if args.json:
        print(json.dumps(outcome.to_json(), allow_nan=False))
    else:
        print(f"{outcome.verdict} ({outcome.state}), seed {outcome.seed}, {outcome.wall_time_s:.1f} s")
        for reason in outcome.reasons:
            print(f"  {reason}")
        print(f"record: {outcome.record}")
    return EXIT[outcome.verdict]


def points_of(text: str) -> int:
    """Pixels of a cloud, in the limits of the cell file. Raises ValueError."""
    points = int(text)
    if not 10_000 <= points <= 5_000_000:
        raise ValueError(f"{points} pixels are outside 10000 to 5000000")
    return points


def numbers_of(pairs: list[str]) -> dict[str, float]:
    """NAME=VALUE pairs. Raises ConfigError."""
    numbers = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise ConfigError(f"{value!r} is not a number", place=f"--set {name}") from None
    return numbers
