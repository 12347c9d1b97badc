"""Every fault of every bus at device level: `python -m tests.wire.campaign --times 20 [--only BUS] [--figures FOLDER]`.

Each strikes at moments that its seed draws. What came of them is written to FOLDER/wire_faults.json: bus, fault, how
often, and what was wrong. A fault that a bus cannot have is named with the reason in `NONE`. Exit 3 where something was
wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cellctl.studies.figures import provenance
from tests.wire.strikes import Strike, axis, force, guard, gun, kducer, modbus, scanner, tool_enable

ROOT = Path(__file__).parents[2]
BUSES: Mapping[str, Mapping[str, Strike]] = MappingProxyType(
    {
        "CAN axis": axis.STRIKES,
        "Modbus TCP": modbus.TCP,
        "Modbus RTU": modbus.RTU,
        "Open Protocol gun": gun.STRIKES,
        "Kolver gun": kducer.STRIKES,
        "tool enable": tool_enable.STRIKES,
        "force line": force.STRIKES,
        "file-drop scanner": scanner.DROP,
        "GenTL scanner": scanner.CAMERA,
        "guard link": guard.STRIKES,
    }
)
ENDED_S = 300.0
"""A strike takes seconds, on a busy machine some tens of them."""
EVERYWHERE = ("cable pulled", "adapter gone", "half frames", "late reply", "duplicate", "wrong id")
"""What any wire can do."""
NONE: Mapping[tuple[str, str], str] = MappingProxyType(
    {("GenTL scanner", "wrong id"): "a buffer carries no name of its request: a late one is stopped before the next"}
)
PAIRS: tuple[tuple[str, str], ...] = tuple((bus, fault) for bus, strikes in BUSES.items() for fault in strikes)


def strike(bus: str, fault: str, seed: int) -> str:
    """What is wrong with one strike, or empty."""
    try:
        with _ended():
            BUSES[bus][fault](seed)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


@contextlib.contextmanager
def _ended() -> Iterator[None]:
    """What goes round and round for ever is ended, too."""

    def ring(number: int, frame: object) -> None:
        raise AssertionError(f"no end after {ENDED_S:g} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, ENDED_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def numbered(number: int) -> tuple[str, str]:
    """One strike of the night: a word for the tally and what is wrong."""
    bus, fault = PAIRS[number % len(PAIRS)]
    wrong = strike(bus, fault, number // len(PAIRS))
    return bus, f"{bus}, {fault}: {wrong}" if wrong else ""


def struck(bus: str, fault: str, times: int, first: int) -> dict[str, Any]:
    """A row of the table."""
    wrong = {seed: told for seed in range(first, first + times) if (told := strike(bus, fault, seed))}
    return {
        "bus": bus,
        "fault": fault,
        "times": times,
        "seeds": [first, first + times],
        "wrong": [{"seed": seed, "what": what[:300]} for seed, what in wrong.items()],
    }


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.wire.campaign", description=__doc__)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", action="append", choices=list(BUSES))
    parser.add_argument("--figures", type=Path, default=ROOT / "docs" / "figures")
    args = parser.parse_args(argv)
    logging.disable(logging.CRITICAL)
    path = args.figures / "wire_faults.json"
    rows = {(row["bus"], row["fault"]): row for row in _earlier(path)}
    entry = provenance(["python", "-m", "tests.wire.campaign", *(argv or sys.argv[1:])], ROOT)
    failed = False
    for bus, fault in PAIRS:
        if args.only and bus not in args.only:
            continue
        row = struck(bus, fault, args.times, args.first)
        print(f"{bus}, {fault}: {row['times']} times, {len(row['wrong'])} wrong", flush=True)
        for one in row["wrong"]:
            print(f"  seed {one['seed']}: {one['what']}", flush=True)
        failed = failed or bool(row["wrong"])
        rows[bus, fault] = row | {"commit": entry["commit"]}
        table = [rows[pair] for pair in PAIRS if pair in rows]
        whole = entry | {"none": {f"{one}, {other}": why for (one, other), why in NONE.items()}, "rows": table}
        path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    return 3 if failed else 0


def _earlier(path: Path) -> list[dict[str, Any]]:
    return list(json.loads(path.read_text(encoding="utf-8"))["rows"]) if path.exists() else []


if __name__ == "__main__":
    sys.exit(main())
