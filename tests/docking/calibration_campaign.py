"""Are stated uncertainties true? `python -m tests.docking.calibration_campaign pose|odds --seeds 400 [--first 1] ...`

pose: normalised error squared per degree of freedom of x, y, theta, real vision, every systematic error redrawn for
each seed. odds: predicted probabilities of insertion against the twin's contact physics, on joints with so little
clearance that some enter and some do not.

Rows are kept in `--rows FILE`; seeds that stand there are not run again. With `--figures FOLDER` the summary joins
`uncertainty.json` and the table beside it.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cellctl.studies.calibration import mean_interval, nees, reliability
from cellctl.studies.figures import provenance
from cellctl.vision.part import Refused
from tests.docking.parts import ROOT
from tests.docking.twin_cases import case, default_recipe, random_recipe, with_clearance
from tests.docking.twin_docks import docked

Row = dict[str, Any]
TIGHT_MM = (0.045, 0.13)
"""Radial clearances of the odds' joints."""
STRENGTHS = (0.7, 2.5)
"""How many times nominal the systematic errors of the odds' twins are."""
ERRORS = {"best": "best_error", "mean": "mean_error"}


def pose_row(seed: int, args: argparse.Namespace) -> Row:
    """Errors of one dock's pose and the covariance that was stated."""
    recipe = random_recipe(seed) if args.geometry == "random" else default_recipe()
    one = case(
        seed, recipe, systematic=args.systematic, correlation_px=0.0 if args.noise == "white" else 3.0,
    )  # fmt: skip
    done = docked(one, points=args.points, moves=args.moves, samples=512)
    row: Row = {name: getattr(done, attribute).tolist() for name, attribute in ERRORS.items()}
    alignment = done.alignment
    return row | {"a": alignment.covariance_a.tolist(), "b": alignment.covariance_b.tolist()}


def odds_row(seed: int, args: argparse.Namespace) -> Row:
    """Forecast and outcome of one dock of a tight joint."""
    draw = np.random.default_rng([seed, 3])
    recipe = random_recipe(seed) if args.geometry == "random" else default_recipe()
    clearance_mm, strength = float(draw.uniform(*TIGHT_MM)), float(draw.uniform(*STRENGTHS))
    one = case(seed, with_clearance(recipe, clearance_mm), systematic=strength)
    done = docked(one, points=args.points, moves=args.moves)
    found = done.alignment
    return {
        "p_insert": found.p_insert,
        "p_force_ok": found.p_force_ok,
        "free": done.free,
        "force_ok": done.total_n <= 10.0,
        "below_total": done.total_n <= found.predicted_peak_force_n,
        "below_bolt": done.bolt_n <= found.predicted_peak_bolt_n,
    }


def pose_summary(rows: Sequence[Row]) -> Row:
    """NEES per degree of freedom with its interval, against both definitions of the best pose, and each component."""
    a, b = (np.array([row[part] for row in rows]) for part in ("a", "b"))
    summary: Row = {
        "sigma_a": np.sqrt(np.mean(np.diagonal(a, axis1=1, axis2=2), axis=0)).tolist(),
        "sigma_b": np.sqrt(np.mean(np.diagonal(b, axis1=1, axis2=2), axis=0)).tolist(),
    }
    for name in ERRORS:
        errors = np.array([row[name] for row in rows])
        ratio = nees(errors, a + b)
        z = errors / np.sqrt(np.diagonal(a + b, axis1=1, axis2=2))
        summary[name] = {
            "nees": float(ratio.mean()),
            "interval95": list(mean_interval(ratio, np.random.default_rng(0))),
            "rms": np.sqrt(np.mean(errors**2, axis=0)).tolist(),
            "z_rms": np.sqrt(np.mean(z**2, axis=0)).tolist(),
            "beyond_2_sigma": np.mean(np.abs(z) > 2.0, axis=0).tolist(),
            "beyond_3_sigma": np.mean(np.abs(z) > 3.0, axis=0).tolist(),
        }
    return summary


def odds_summary(rows: Sequence[Row]) -> Row:
    """Reliability of both probabilities, and how often the predicted 95 % forces were kept."""

    def column(name: str) -> np.ndarray:
        return np.array([row[name] for row in rows])

    return {
        "p_insert": asdict(reliability(column("p_insert"), column("free"))),
        "p_force_ok": asdict(reliability(column("p_force_ok"), column("force_ok"))),
        "below_predicted_total": float(column("below_total").mean()),
        "below_predicted_bolt": float(column("below_bolt").mean()),
    }


def rows_of(seeds: range, make: Callable[[int], Row], path: Path | None) -> list[Row]:
    """A row for each seed, from the file where it stands there; refusals carry their reason."""
    known: dict[int, Row] = {}
    if path is not None and path.exists():
        known = {row["seed"]: row for row in map(json.loads, path.read_text(encoding="utf-8").splitlines())}
    for seed in seeds:
        if seed in known:
            continue
        begin = time.process_time()
        try:
            row = make(seed)
        except Refused as refusal:
            row = {"refused": str(refusal)}
        known[seed] = {"seed": seed, **row, "cpu_s": time.process_time() - begin}
        if path is not None:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(known[seed]) + "\n")
    return [known[seed] for seed in seeds]


def add_figure(folder: Path, entry: Row) -> None:
    """Put `entry` in the place of an earlier one of the same command, and write the table."""
    path = folder / "uncertainty.json"
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    entries = sorted([one for one in before if one["command"] != entry["command"]] + [entry], key=_command)
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    (folder / "uncertainty.md").write_text(table(entries), encoding="utf-8")


def _command(entry: Row) -> str:
    return str(entry["command"])


def table(entries: Sequence[Row]) -> str:
    """Markdown of all entries."""
    poses = [entry for entry in entries if entry["study"] == "pose"]
    odds = [entry for entry in entries if entry["study"] == "odds"]
    lines = [
        "Pose: normalised error squared per degree of freedom of x, y, theta, 95 % interval by bootstrap, against the",
        "best pose of the true parts (and against the mean of their bolts); sigmas of type A and B stated on average.",
        "",
        "| command | docks | NEES | against the mean | z of x, y, theta | A: um, um, mdeg | B: um, um, mdeg | commit |",
        "|---|---|---|---|---|---|---|---|",
        *(_pose_line(entry) for entry in poses),
        "",
        "Odds: predicted probability against the twin's contact physics; slope of the log odds with standard error,",
        "slope of the rate, Brier skill over the base rate, tenths whose 95 % interval holds their mean prediction.",
        "",
        "| command | docks | event | rate | predicted | slope | linear slope | skill | tenths | commit |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *(line for entry in odds for line in _odds_lines(entry)),
    ]
    return "\n".join(lines) + "\n"


def _pose_line(entry: Row) -> str:
    best, mean = entry["best"], entry["mean"]
    low, high = best["interval95"]
    z = ", ".join(f"{value:.2f}" for value in best["z_rms"])
    a, b = (", ".join(f"{1e3 * value:.1f}" for value in entry[name]) for name in ("sigma_a", "sigma_b"))
    ratio = f"{best['nees']:.2f} ({low:.2f} to {high:.2f}) | {mean['nees']:.2f}"
    return f"| `{entry['command']}` | {entry['docks']} | {ratio} | {z} | {a} | {b} | {entry['commit']} |"


def _odds_lines(entry: Row) -> list[str]:
    lines = []
    for name, event in (("p_insert", "free of contact"), ("p_force_ok", "total below 10 N")):
        found = entry[name]
        held = sum(one["low"] <= one["predicted"] <= one["high"] for one in found["deciles"])
        lines.append(
            f"| `{entry['command']}` | {entry['docks']} | {event} | {found['base_rate']:.3f} "
            f"| {found['mean_predicted']:.3f} | {found['slope']:.2f} +- {found['sigma_slope']:.2f} "
            f"| {found['linear_slope']:.2f} | {found['skill']:.2f} | {held} of 10 | {entry['commit']} |"
        )
    return lines


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.docking.calibration_campaign", description=__doc__)
    parser.add_argument("study", choices=("pose", "odds"))
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--points", type=int, default=100_000, help="of each scan; 0 draws measurements instead")
    parser.add_argument("--moves", type=int, default=2, help="motions, the last one after an alignment of its own")
    parser.add_argument("--noise", choices=("white", "correlated"), default="correlated")
    parser.add_argument("--systematic", type=float, default=1.0, help="times nominal, for pose")
    parser.add_argument("--geometry", choices=("default", "random"), default="default")
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--figures", type=Path)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    words = list(sys.argv[1:] if argv is None else argv)
    args = _parser().parse_args(words)
    make, summarise = (pose_row, pose_summary) if args.study == "pose" else (odds_row, odds_summary)
    rows = rows_of(range(args.first, args.first + args.seeds), lambda seed: make(seed, args), args.rows)
    good = [row for row in rows if "refused" not in row]
    entry = provenance(["python", "-m", "tests.docking.calibration_campaign", *_lasting(words)], ROOT)
    entry |= {"study": args.study, "docks": len(good), "refused": len(rows) - len(good)} | summarise(good)
    entry["cpu_s_per_dock"] = float(np.mean([row["cpu_s"] for row in rows]))
    print(json.dumps(entry, indent=1))
    if args.figures is not None:
        add_figure(args.figures, entry)
    return 0


def _lasting(words: Sequence[str]) -> list[str]:
    """The words that decide the result, without where it is kept."""
    kept: list[str] = []
    skip = False
    for word in words:
        if not skip and word not in ("--rows", "--figures"):
            kept.append(shlex.quote(word))
        skip = word in ("--rows", "--figures")
    return kept


if __name__ == "__main__":
    sys.exit(main())
