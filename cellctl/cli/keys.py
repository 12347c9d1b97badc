"""`cellctl keys add|remove|list`: who may work with a cell whose sign-in is by keys. A key is shown once."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from cellctl.api.auth import Role
from hal.config import load_cell
from hal.errors import ConfigError


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser("keys", help="keys of machines and people")
    commands = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for action, told in (("add", "make a key and show it"), ("remove", "let its holder in no more"), ("list", "all")):
        each = commands.add_parser(action, help=told)
        if action != "list":
            each.add_argument("name", metavar="NAME", help="machine or person, as the audit shall name it")
        if action == "add":
            each.add_argument("--role", required=True, choices=[str(role) for role in Role])
        each.add_argument("--cell", type=Path, required=True, help="cell file; its [auth] names the file of keys")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Exit 0 done, 2 where a file or a name is wrong."""
    from cellctl.api.keys import add_key, load_keys, remove_key

    try:
        path = load_cell(args.cell).keys_path
        match args.action:
            case "add":
                key = add_key(path, args.name, Role(args.role))
                print(f"{args.name} ({args.role}) is in {path}. The key is shown this once:", file=sys.stderr)
                print(key)
            case "remove":
                remove_key(path, args.name)
                print(f"{args.name} is let in no more")
            case "list":
                for one in load_keys(path):
                    print(f"{one.name:24} {one.role}")
    except ConfigError as error:
        print(f"cellctl keys: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"cellctl keys: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    return 0
