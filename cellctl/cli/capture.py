"""`cellctl capture`: the bytes on one bus with their times and directions, as JSON lines (format: hal.capture)."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from cellctl.cli.options import add_cell_options, refused, told
from cellctl.commissioning.capture import Order, capture
from cellctl.signals import ending
from hal.config import CellConfig, load_cell
from hal.errors import CellError, ConfigError
from hal.tap import Tap, bus_named


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser("capture", help="record the bytes on a bus")
    parser.add_argument("bus", metavar="BUS", help="can, or a device: the bus that it is on")
    add_cell_options(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="JSON lines")
    parser.add_argument("--seconds", type=float, metavar="S", help="how long; default: until Ctrl-C")
    parser.add_argument(
        "--listen", default="", metavar="PORT", help="port (TCP) or path (serial) where a controller finds the relay"
    )
    parser.add_argument("--ask", action="store_true", help="ask the devices on the bus meanwhile, as `devices` does")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 where something was recorded to its end, 3 where the bus cannot be had, 2 for a wrong file or option."""
    told()
    try:
        config = load_cell(args.cell)
        order = _order(config, args)
        counts = asyncio.run(_captured(config, args.recipe, order))
    except (CellError, OSError) as error:
        return refused("capture", error, args.json)
    if args.json:
        print(json.dumps({"file": str(order.file), "bus": order.bus.name, "bytes": counts}))
    else:
        print(f"{order.file}: {counts['out']} bytes out, {counts['in']} in")
    return 0


def _order(config: CellConfig, args: argparse.Namespace) -> Order:
    """Raises ConfigError."""
    bus = bus_named(config, args.bus)
    if args.seconds is not None and not args.seconds > 0.0:
        raise ConfigError("must be above 0", place="--seconds", unit="s")
    if bus.kind != "canopen" and not (args.listen or args.ask):
        text = f"{bus.name} has two ends: a controller comes through --listen, or --ask has this command be one"
        raise ConfigError(text, place="--listen")
    return Order(bus, args.output, args.listen, args.ask, args.seconds)


async def _captured(config: CellConfig, recipe: Path, order: Order) -> dict[str, int]:
    def ready(tap: Tap) -> None:
        print(f"recording {', '.join(order.bus.devices)} at {tap.where}; Ctrl-C ends", file=sys.stderr, flush=True)

    ended = asyncio.Event()
    with ending(ended.set):
        return await capture(config, recipe, order, ended, ready)
