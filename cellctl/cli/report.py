"""`cellctl report`: the report of a run, from its id or from its sealed record. Exit 0 written, 2 unreadable."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from cellctl.records.blobs import load
from cellctl.records.chain import Row
from cellctl.records.errors import RecordError
from cellctl.records.journal import read_rows
from cellctl.records.report import report_of
from cellctl.records.summary import summarise
from cellctl.records.verify import read_record
from cellctl.view.of_run import page_of


def add_parser(subparsers: Any) -> None:
    """Add `report` to the commands."""
    parser = subparsers.add_parser("report", help="write the report of a run as a page (HTML)")
    parser.add_argument("run_id", metavar="RUN", help="id of a run in the data folder, or a sealed record")
    parser.add_argument("--data", type=Path, default=Path("data"), help="data folder (default data)")
    parser.add_argument("--out", type=Path, help="file to write (default RUN.html)")
    parser.add_argument("--view", type=Path, help="also write a page (HTML) that shows the run's newest scans")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write and print where. Returns the exit code."""
    try:
        rows, blobs = _run(args.run_id, args.data)
        summary = summarise(rows)
        out: Path = args.out or Path(f"{summary.run_id or 'run'}.html")
        out.write_text(report_of(rows, blobs), encoding="utf-8")
        if args.view is not None:
            args.view.write_text(page_of(rows, blobs), encoding="utf-8")
    except (RecordError, OSError) as error:
        print(f"cellctl report: {error}", file=sys.stderr)
        if args.json:
            print(json.dumps({"error": {"code": "unreadable", "reason": str(error)}}))
        return 2
    document = {"report": str(out), "run_id": summary.run_id, "state": summary.state, "verdict": summary.verdict}
    print(json.dumps(document) if args.json else f"{out}: run {summary.run_id}, {summary.verdict or 'no verdict'}")
    return 0


def _run(name: str, data: Path) -> tuple[tuple[Row, ...], Callable[[str], dict[str, Any]]]:
    """Rows of the run's journal, and a reader of its blobs."""
    record = Path(name)
    if record.is_file():
        return read_record(record)
    folder = data / "runs" / record.name
    if not (folder / "journal.sqlite").exists():
        raise FileNotFoundError(f"no run {name!r} in {data}, and no record of that name")
    return read_rows(folder / "journal.sqlite"), partial(load, folder / "blobs")
