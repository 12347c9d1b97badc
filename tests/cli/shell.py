"""The commands of this folder's tests, run in this process."""

from __future__ import annotations

import argparse
from pathlib import Path

from cellctl.cli import calibrate, report, validate, verify

ROOT = Path(__file__).parents[2]


def cellctl(*words: str) -> int:
    """Run one command line; gives its exit code."""
    parser = argparse.ArgumentParser("cellctl")
    subparsers = parser.add_subparsers(required=True)
    for command in (calibrate, report, validate, verify):
        command.add_parser(subparsers)
    args = parser.parse_args(words)
    code: int = args.run(args)
    return code
