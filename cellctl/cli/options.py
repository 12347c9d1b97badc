"""What the commissioning commands share: the cell, its parts where it is fake, and how a refusal is told."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path

from hal.errors import CellError, ConfigError

ROOT = Path(__file__).parents[2]
PARTS = ROOT / "recipes" / "lpt_shaft_36.toml"


def add_cell_options(parser: argparse.ArgumentParser) -> None:
    """`--cell`, `--recipe` and `--json`."""
    parser.add_argument("--cell", type=Path, required=True, help="cell file (TOML)")
    parser.add_argument("--recipe", type=Path, default=PARTS, help="the parts on fake devices (default lpt_shaft_36)")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")


def told() -> None:
    """Warnings of devices and buses go to standard error."""
    logging.basicConfig(stream=sys.stderr, level=logging.ERROR, format="%(levelname)s %(name)s: %(message)s")


def refused(command: str, error: Exception, as_json: bool) -> int:
    """Say why nothing was done, or not all. Gives the exit code: 2 for what was given, 3 for what the cell says."""
    print(f"cellctl {command}: {error}", file=sys.stderr)
    if as_json:
        code = error.code if isinstance(error, CellError) else "input_invalid"
        print(json.dumps({"error": {"code": code, "reason": str(error)}}))
    return 3 if isinstance(error, CellError) and not isinstance(error, ConfigError) else 2
