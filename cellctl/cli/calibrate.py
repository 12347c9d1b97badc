"""`cellctl calibrate camera|axes|force`: a part of the calibration file measured on the cell itself."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path
from typing import Any

from cellctl.cli.run import numbers_of, points_of
from cellctl.cli.serve import ROOT
from cellctl.recipe import load_recipe
from hal.config import load_cell
from hal.errors import CellError, ConfigError

RECIPE = ROOT / "recipes" / "lpt_shaft_36.toml"


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser("calibrate", help="camera poses, axes, force gain")
    parser.add_argument("procedure", choices=("camera", "axes", "force"))
    parser.add_argument("--cell", type=Path, required=True, help="cell file (TOML)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="calibration file to be written")
    parser.add_argument("--base", type=Path, help="file to go on from; default: the output, else the cell's own")
    parser.add_argument("--recipe", type=Path, default=RECIPE, help="the parts that are used")
    parser.add_argument("--rotor", default="R-1", help="serial number of the rotor that is presented")
    parser.add_argument("--shaft", default="S-1", help="serial number of the shaft that is presented")
    parser.add_argument("--mandrel-mm", type=float, default=80.0, help="the mandrel's certified diameter (default 80)")
    parser.add_argument("--masses", type=_masses, default=(), metavar="KG,KG,...", help="weights at hand, with 0")
    parser.add_argument("--mass-sigma", type=float, default=3e-5, help="their relative uncertainty (default 3e-5)")
    parser.add_argument("--looks", type=int, default=6, help="looks at the artefact in each view (default 6)")
    parser.add_argument("--valid-days", type=float, help="default: as long as the file before")
    parser.add_argument("--seed", type=int, help="the twin's; default: the cell file's")
    parser.add_argument("--points", type=points_of, help="pixels of the twin's clouds; default: the cell file's")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a number of the twin")
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 written, 3 refused or failed with nothing written, 2 bad input."""
    from cellctl.calibrating.file import save_calibration
    from cellctl.calibration import load_calibration
    from cellctl.calibration_runner import CalibrationRequest, base_path, calibrate_once
    from cellctl.ports import RunHeld
    from cellctl.runner import with_twin
    from cellctl.vision.part import Refused

    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        config = with_twin(load_cell(args.cell), points=args.points, overrides=numbers_of(args.set))
        request = CalibrationRequest(
            procedure=args.procedure,
            config=config,
            base=load_calibration(base_path(config, args.base, args.output)),
            recipe=load_recipe(args.recipe),
            seed=config.twin.seed if args.seed is None else args.seed,
            masses_kg=args.masses,
            mass_sigma=args.mass_sigma,
            looks=args.looks,
            mandrel_mm=args.mandrel_mm,
            valid_days=args.valid_days,
            rotor_serial=args.rotor,
            shaft_serial=args.shaft,
            tell=lambda text: print(text, file=sys.stderr, flush=True),
        )
        found = calibrate_once(request)
        save_calibration(args.output, found)
    except (ConfigError, OSError) as error:
        print(f"cellctl: {error}", file=sys.stderr)
        return 2
    except (Refused, RunHeld) as refusal:
        return _refused(args, refusal.code, refusal.reason)
    except CellError as error:
        return _refused(args, error.code, str(error))
    except KeyboardInterrupt:
        return _refused(args, "interrupted", "the cell was made safe and let go")
    made = found.made[request.procedure]
    if args.json:
        print(json.dumps({"id": found.id, "file": str(args.output), **made.model_dump(mode="json")}))
    else:
        print(f"{found.id} written to {args.output}, from {made.stops} stops")
        for name, value in made.figures.items():
            print(f"  {name:28} {value:.5g}")
    return 0


def _refused(args: argparse.Namespace, code: str, reason: str) -> int:
    if args.json:
        print(json.dumps({"refused": {"code": code, "reason": reason}}))
    print(f"refused ({code}): {reason}\nnothing was written", file=sys.stderr)
    return 3


def _masses(text: str) -> tuple[float, ...]:
    """Kilograms, separated by commas. Raises ValueError."""
    masses = tuple(float(part) for part in text.split(","))
    if not all(0.0 <= mass <= 1e5 for mass in masses):
        raise ValueError(f"{text}: masses are kilograms from 0 on")
    return masses
