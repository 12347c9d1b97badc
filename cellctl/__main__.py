"""The command line. Each command is a module of `cellctl.cli` with ``add_parser(subparsers)`` and ``run(args)``."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Sums must not depend on how many threads a machine has: the same input gives the same bits. Read by the numeric
libraries when they are first imported, so set before any command is."""

COMMANDS = (
    "demo", "serve", "simulate", "run", "measure", "validate", "study", "verify", "report", "devices", "jog", "capture",
    "calibrate", "keys",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; gives its exit code."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(prog="cellctl", description="Cell controller of the shaft assembly.")
    parser.add_argument("--version", action="version", version=version("cellctl"))
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    # Only the module that is needed is imported: vision and the service are slow to load.
    wanted = given[:1] if given[:1] and given[0] in COMMANDS else COMMANDS
    for name in wanted:
        if importlib.util.find_spec(f"cellctl.cli.{name}") is not None:
            importlib.import_module(f"cellctl.cli.{name}").add_parser(subparsers)
    args = parser.parse_args(given)
    code: int = args.run(args)
    return code


if __name__ == "__main__":
    sys.exit(main())
