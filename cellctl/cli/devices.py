"""`cellctl devices`: who every device of a cell is, how it is and what it reads. Nothing moves."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cellctl.cli.options import add_cell_options, refused, told
from cellctl.commissioning.bench import opened
from cellctl.commissioning.live import spoken
from cellctl.commissioning.survey import Found, survey
from cellctl.signals import ending
from hal.config import CellConfig, load_cell
from hal.errors import CellError
from hal.interfaces import Identity

HEADINGS = ("device", "kind", "address", "identity", "firmware", "health", "reads")


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "devices", help="identity, firmware, health and live values of every device"
    )
    add_cell_options(parser)
    parser.add_argument("--watch", type=float, metavar="S", help="again every S seconds until Ctrl-C")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 where every device answers, 3 where one does not or the cell is in use, 2 for a wrong file."""
    told()
    if args.watch is not None and (args.json or not args.watch > 0.0):
        return refused("devices", ValueError("--watch takes seconds above 0, and no --json"), args.json)
    try:
        found = asyncio.run(looked(load_cell(args.cell), args.recipe, args.watch))
    except CellError as error:
        return refused("devices", error, args.json)
    if args.json:
        print(json.dumps({"devices": [asdict(one) for one in found]}, allow_nan=False))
    elif args.watch is None:
        print(table(found))
    return 3 if any(one.error for one in found) else 0


async def looked(config: CellConfig, recipe: Path, watch_s: float | None) -> tuple[Found, ...]:
    """What was found, the last time where it is looked again and again. Raises CellError."""
    async with opened(config, recipe) as cell:
        found = await survey(cell, config)
        if watch_s is None:
            return found
        ended = asyncio.Event()
        with ending(ended.set):
            while not ended.is_set():
                print("\033[H\033[2J" * sys.stdout.isatty() + table(found), flush=True)
                try:
                    async with asyncio.timeout(watch_s):
                        await ended.wait()
                except TimeoutError:
                    found = await survey(cell, config)
        return found


def table(found: tuple[Found, ...]) -> str:
    """One line a device, and how many failed."""
    rows = [HEADINGS, *map(row, found)]
    widths = [max(len(cells[column]) for cells in rows) for column in range(len(HEADINGS) - 2)]
    lines = []
    for cells in rows:
        fixed = "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=False))
        lines.append(f"{fixed}  {'; '.join(filter(None, cells[-2:])) if cells is not HEADINGS else 'health; reads'}")
    failed = sum(1 for one in found if one.error)
    return "\n".join((*lines, f"{len(found) - failed} of {len(found)} devices answer"))


def row(one: Found) -> tuple[str, ...]:
    """The cells of one device."""
    health = f"FAILED {one.error}" if one.error else one.health
    firmware = one.identity.firmware if one.identity else ""
    return one.name, one.kind, one.address, whole(one.identity), firmware, health, spoken(one.values)


def whole(identity: Identity | None) -> str:
    """Vendor, model and serial number."""
    if identity is None:
        return ""
    simulated = " (simulated)" if identity.simulated else ""
    return f"{identity.vendor} {identity.model} {identity.serial}{simulated}"
