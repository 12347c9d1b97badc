"""`cellctl verify`: a sealed record, checked offline. Exit 0 whole, 3 rejected, 2 unreadable."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from cellctl.records.canonical import plain_of
from cellctl.records.errors import RecordCorrupt
from cellctl.records.seal import read_public
from cellctl.records.verify import verify


def add_parser(subparsers: Any) -> None:
    """Add `verify` to the commands."""
    parser = subparsers.add_parser("verify", help="check a sealed record: signature, every file, chain, commands")
    parser.add_argument("record", type=Path, metavar="RECORD", help="the sealed record (ZIP)")
    parser.add_argument(
        "--key", type=Path, metavar="PUB", help="public key of the cell (PEM); without it nothing is authenticated"
    )
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Check and print. Returns the exit code."""
    try:
        key = read_public(args.key.read_bytes()) if args.key is not None else None
        result = verify(args.record, key)
    except (OSError, RecordCorrupt) as error:
        print(f"cellctl verify: {error}", file=sys.stderr)
        if args.json:
            print(json.dumps({"error": {"code": "unreadable", "reason": str(error)}}))
        return 2
    if args.json:
        print(json.dumps(plain_of(result)))
    elif result.status == "authentic":
        print(f"authentic: run {result.run_id}, {result.rows} rows, signed by the cell of that key")
    elif result.status == "consistent":
        print(f"consistent, not authenticated: run {result.run_id}, {result.rows} rows; give --key to authenticate")
    else:
        print("rejected: " + "; ".join(result.reasons))
    return 0 if result.ok else 3
