"""`cellctl serve`: the service. Exit 0 after an ordered end, 2 where a file or a setting is wrong, 3 where another
command has the devices of the cell in hand."""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from cellctl.app import Service, serve
from cellctl.service_rules import Settings, clock, refuse_unfit
from hal.config import load_cell
from hal.errors import ConfigError, DeviceRefused
from hal.systemd import alive

ROOT = Path(__file__).parents[2]
"""Where recipes and example cells lie beside the package."""


def add_parser(subparsers: Any) -> None:
    """Add `serve` to the commands."""
    parser = subparsers.add_parser("serve", help="the cell service with its API and page")
    parser.add_argument("--cell", type=Path, required=True, help="cell file (TOML)")
    add_service_options(parser)
    parser.add_argument("--speed", type=float, default=1.0, help="cell seconds per second, 1 unless all is fake")
    parser.set_defaults(run=run)


def add_service_options(parser: argparse.ArgumentParser) -> None:
    """Options that `serve` and `demo` share."""
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1)")
    parser.add_argument("--port", type=int, default=8080, help="port to listen on, 0 for a free one (default 8080)")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of runs and orders (default data)")
    parser.add_argument("--recipes", type=Path, default=ROOT / "recipes", help="folder of recipes")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")


def run(args: argparse.Namespace) -> int:
    """Serve until told to end."""

    async def tell(service: Service) -> None:
        if args.json:
            told = {"url": service.url, "token": service.token or None, "data": str(service.data)}
            print(json.dumps(told), flush=True)
        elif not service.token:
            print(f"page   {service.url}\nAPI    {service.url}/api/v1\nsign in with a key\nCtrl-C ends", flush=True)
        else:
            print(f"page   {service.url}/#token={service.token}\nAPI    {service.url}/api/v1\ntoken  {service.token}")
            print("Ctrl-C ends", flush=True)
        await alive()

    return run_service(settings_of(args, args.cell, args.speed), tell)


def settings_of(args: argparse.Namespace, cell: Path, speed: float) -> Settings:
    """The settings that the options ask for."""
    return Settings(cell=cell, data=args.data, recipes=args.recipes, host=args.host, port=args.port, speed=speed)


def run_service(settings: Settings, during: Callable[[Service], Awaitable[None]]) -> int:
    """Serve on a clock of the asked speed. Gives the exit code."""
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        config = load_cell(settings.cell)
        refuse_unfit(settings, config)
        # Slow to import, and not needed to say what is wrong with the settings.
        from cellctl.workplace import open_workplace

        with asyncio.Runner(loop_factory=lambda: clock(settings.speed, config)) as runner:
            runner.run(serve(settings, open_workplace, during=during))
    except ConfigError as error:
        print(f"cellctl: {error}", file=sys.stderr)
        return 2
    except DeviceRefused as error:
        print(f"cellctl: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        return 0
    return 0
