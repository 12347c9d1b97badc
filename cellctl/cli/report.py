"""`cellctl report`: the report of a run, from its id or from its sealed record. Exit 0 written, 2 unreadable."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from cellctl.records.errors import RecordError
from cellctl.records.journal import read_rows
from cellctl.records.report import report_of
from cellctl.records.store import report_from
from cellctl.records.summary import RunSummary, summarise
from cellctl.records.verify import read_record


def add_parser(subparsers: Any) -> None:
    """Add `report` to the commands."""
    parser = subparsers.add_parser("report", help="write the report of a run as a page (HTML)")
    parser.add_argument("run_id", metavar="RUN", help="id of a run in the data folder, or a sealed record")
    parser.add_argument("--data", type=Path, default=Path("data"), help="data folder (default data)")
    parser.add_argument("--out", type=Path, help="file to write (default RUN.html)")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write and print where. Returns the exit code."""
    try:
        text, summary = _report(args.run_id, args.data)
        out: Path = args.out or Path(f"{summary.run_id or 'run'}.html")
        out.write_text(text, encoding="utf-8")
    except (RecordError, OSError) as error:
        print(f"cellctl report: {error}", file=sys.stderr)
        if args.json:
            print(json.dumps({"error": {"code": "unreadable", "reason": str(error)}}))
        return 2
    document = {"report": str(out), "run_id": summary.run_id, "state": summary.state, "verdict": summary.verdict}
    print(json.dumps(document) if args.json else f"{out}: run {summary.run_id}, {summary.verdict or 'no verdict'}")
    return 0


def _report(name: str, data: Path) -> tuple[str, RunSummary]:
    record = Path(name)
    if record.is_file():
        rows, curves = read_record(record)
        return report_of(rows, curves), summarise(rows)
    folder = data / "runs" / record.name
    if not (folder / "journal.sqlite").exists():
        raise FileNotFoundError(f"no run {name!r} in {data}, and no record of that name")
    return report_from(folder), summarise(read_rows(folder / "journal.sqlite"))
