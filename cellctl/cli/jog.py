"""`cellctl jog`: one axis moved by hand, slowly, under all interlocks. Ctrl-C halts it."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from cellctl.cli.options import add_cell_options, refused, told
from cellctl.commissioning.bench import opened
from cellctl.commissioning.jog import Jogged, Plan, Wish, carry_out, guarded, plan_of, reach, refuse
from cellctl.signals import ending
from hal.config import CellConfig, load_cell
from hal.errors import CellError, ConfigError
from hal.interfaces import AxisState
from hal.permits import AXES


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser("jog", help="move one axis by hand, under all interlocks")
    parser.add_argument("axis", choices=AXES, metavar="AXIS", help=", ".join(AXES))
    add_cell_options(parser)
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument("--to", type=float, metavar="POS", help="position, mm or deg")
    way.add_argument("--by", type=float, metavar="DIST", help="distance from here, mm or deg")
    way.add_argument("--home", action="store_true", help="find the reference; speed is the drive's own")
    parser.add_argument("--speed", type=float, metavar="S", help="mm/s or deg/s; slow where it is not given")
    parser.add_argument(
        "--limit", type=float, metavar="N", help="a lower contact force than 10 N (jack), 25 N (gun feed)"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 where the axis arrived, 3 where it was refused or stopped, 2 for a wrong file or nobody to agree."""
    told()
    wish = Wish(args.axis, args.to, args.by, args.speed, args.limit)
    say = partial(print, file=sys.stderr if args.json else sys.stdout, flush=True)
    try:
        for name in ("to", "by", "speed", "limit"):
            _number(name, getattr(args, name))
        if not args.yes and not sys.stdin.isatty():
            raise ConfigError("nobody is here to agree: say --yes", place="--yes")
        jogged = asyncio.run(jog(load_cell(args.cell), args.recipe, wish, yes=args.yes, say=say))
    except CellError as error:
        return refused("jog", error, args.json)
    if jogged is None:
        say("nothing was moved")
        if args.json:
            print(json.dumps({"axis": args.axis, "end": "declined"}))
        return 3
    say(f"{jogged.end}{f': {jogged.reason}' if jogged.reason else ''}; {jogged.rest}")
    if args.json:
        print(json.dumps({"axis": args.axis} | asdict(jogged), allow_nan=False))
    return 0 if jogged.end == "arrived" else 3


async def jog(config: CellConfig, recipe: Path, wish: Wish, *, yes: bool, say: Callable[[str], None]) -> Jogged | None:
    """None where nobody agreed. Raises CellError."""
    halt = asyncio.Event()
    with ending(halt.set):
        async with opened(config, recipe) as cell:
            await reach(cell, wish.axis)
            plan = await plan_of(cell, config, wish)
            async with guarded(cell, config, plan):
                await refuse(cell, plan)
                say(str(plan))
                if not (yes or await agreed(halt)) or halt.is_set():
                    return None
                return await carry_out(cell, plan, halt, lambda state: _on_the_way(plan, state, say))


async def agreed(halt: asyncio.Event) -> bool:
    """Ask on the terminal. The loop goes on meanwhile: drives stop without their heartbeat."""
    print("move? [y/N] ", end="", file=sys.stderr, flush=True)
    loop = asyncio.get_running_loop()
    said: list[str] = []
    typed = asyncio.Event()

    def read() -> None:
        said.append(sys.stdin.readline())
        typed.set()

    loop.add_reader(sys.stdin, read)
    waits = [asyncio.ensure_future(event.wait()) for event in (typed, halt)]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        loop.remove_reader(sys.stdin)
        for wait in waits:
            wait.cancel()
    return bool(said) and said[0].strip().lower() in ("y", "yes")


def _on_the_way(plan: Plan, state: AxisState, say: Callable[[str], None]) -> None:
    """On a terminal each overwrites the one before."""
    text = f"  {state.position:.3f} {plan.unit}, {state.velocity + 0.0:.3f} {plan.unit}/s"
    say(f"{text}\033[K\033[A" if sys.stdout.isatty() else text)


def _number(name: str, value: float | None) -> None:
    """Raises ConfigError for what is no number to move by."""
    if value is not None and not abs(value) < 1e6:
        raise ConfigError(f"{value} is no number to move by", place=f"--{name}")
    if value is not None and name in ("speed", "limit") and not value > 0.0:
        raise ConfigError(f"{value:g} is not positive", place=f"--{name}")
