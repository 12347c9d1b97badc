"""`cellctl study dock`: Monte Carlo of docking. Exit 0 done (whatever came of it), 2 bad input."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellctl.cli.run import numbers_of
from cellctl.recipe import load_recipe
from hal.config import load_cell
from hal.errors import ConfigError, WorkerError

if TYPE_CHECKING:
    from cellctl.dock_runner import DockOutcome
    from cellctl.studies.dock import DockStudy, PoseSigma

ROOT = Path(__file__).parents[2]
RECIPE = ROOT / "recipes" / "lpt_shaft_36.toml"
CELL = ROOT / "deploy" / "cell.fake.toml"
TOLD_EVERY_S = 10.0
LISTED = 10
"""Failures in the text."""


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    study = subparsers.add_parser("study", help="many runs at once")
    studies = study.add_subparsers(dest="study", metavar="STUDY", required=True)
    parser: argparse.ArgumentParser = studies.add_parser(
        "dock",
        help="Monte Carlo of docking",
        description="With a sigma the final pose is drawn about the true optimum, gates and retries off; without, "
        "each dock is found by real vision with its gates and loops.",
    )
    parser.add_argument("--runs", type=int, required=True, help="number of docks")
    parser.add_argument("--seed", type=int, default=1, help="of the first dock; the next ones count on (default 1)")
    parser.add_argument("--theta-sigma-deg", type=float, help="of the drawn angle; 0 where only the other is given")
    parser.add_argument("--xy-sigma-mm", type=float, help="of the drawn x and y; 0 where only the other is given")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="override a number of the twin"
    )
    parser.add_argument("--level", choices=("ideal", "nominal", "hostile"), default="nominal")
    parser.add_argument("--points", type=int, help="of a cloud; default: the cell file's")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    parser.add_argument("--recipe", type=Path, default=RECIPE)
    parser.add_argument("--cell", type=Path, default=CELL)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also put the result into FILE and its .md table")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    from cellctl.studies.dock import run_study, summary
    from cellctl.studies.figures import add_figure, provenance

    began = time.monotonic()
    try:
        study = study_of(args)
        _tell(f"docks with the seeds {study.seeds()[0]} to {study.seeds()[-1]}, level {study.config.twin.level}")
        outcomes = run_study(study, workers=args.workers, on_dock=_progress(study.runs))
    except (ConfigError, WorkerError) as error:
        _tell(f"cellctl study: {error}")
        return 2
    document = asked(study) | summary(outcomes)
    if args.figure is not None:
        cost = {"wall_s": round(time.monotonic() - began, 1), "cpu_s": round(os.times().children_user, 1)}
        add_figure(args.figure, provenance(command_of(args), ROOT) | document | cost)
    print(json.dumps(document, allow_nan=False) if args.json else as_text(document))
    return 0


def study_of(args: argparse.Namespace) -> DockStudy:
    """What the command line asks. Raises ConfigError."""
    from cellctl.runner import with_twin
    from cellctl.studies.dock import DockStudy

    if args.runs < 1 or args.seed < 0 or args.workers < 1:
        raise ConfigError("runs and workers start at 1, seeds at 0", place="--runs, --workers, --seed")
    config = with_twin(load_cell(args.cell), level=args.level, overrides=numbers_of(args.set))
    if args.points is not None:
        if not 10_000 <= args.points <= 5_000_000:
            raise ConfigError("must lie between 10000 and 5000000", place="--points")
        config = config.model_copy(update={"twin": config.twin.model_copy(update={"points": args.points})})
    return DockStudy(load_recipe(args.recipe), config, args.runs, args.seed, _sigma(args))


def _sigma(args: argparse.Namespace) -> PoseSigma | None:
    from cellctl.studies.dock import PoseSigma

    given = {"--theta-sigma-deg": args.theta_sigma_deg, "--xy-sigma-mm": args.xy_sigma_mm}
    if all(value is None for value in given.values()):
        return None
    for place, value in given.items():
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise ConfigError("must be finite and not negative", place=place)
    return PoseSigma(args.theta_sigma_deg or 0.0, args.xy_sigma_mm or 0.0)


def command_of(args: argparse.Namespace) -> list[str]:
    """The command as it would be typed again, without what changes no result."""
    words = ["cellctl", "study", "dock", "--runs", str(args.runs), "--seed", str(args.seed)]
    optional = {"--theta-sigma-deg": args.theta_sigma_deg, "--xy-sigma-mm": args.xy_sigma_mm, "--points": args.points}
    for name, value in optional.items():
        words += [name, str(value)] if value is not None else []
    for pair in args.set:
        words += ["--set", pair]
    words += ["--level", args.level] if args.level != "nominal" else []
    for name, path, usual in (("--recipe", args.recipe, RECIPE), ("--cell", args.cell, CELL)):
        words += [name, path.name] if path != usual else []
    return words


def asked(study: DockStudy) -> dict[str, Any]:
    """The head of the document: all that the results depend on beside the program."""
    twin, sigma = study.config.twin, study.sigma
    head: dict[str, Any] = {
        "study": "dock",
        "pose": "by sight" if sigma is None else "drawn",
        "recipe": study.recipe.recipe.id,
        "recipe_hash": study.recipe.content_hash,
        "seeds": [study.seeds()[0], study.seeds()[-1]],
        "level": twin.level,
        "overrides": dict(twin.overrides),
    }
    if sigma is None:
        return head | {"points": twin.points}
    return head | {"theta_sigma_deg": sigma.theta_deg, "xy_sigma_mm": sigma.xy_mm}


def as_text(document: dict[str, Any]) -> str:
    """What a person wants to see first."""
    low, high = document["interval95"]
    bolt_n, total_n = document["peak_bolt_n"], document["peak_total_n"]
    lines = [
        f"{document['succeeded']} of {document['runs']} docks succeeded "
        f"({100 * document['rate']:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %)",
        f"all studs in    {100 * document['inserted_rate']:.1f} %",
        f"below 10 N      {100 * document['force_ok_rate']:.1f} %",
        f"refused         {document['refused']}",
        f"peak of a stud  {bolt_n['p95']:.1f} N (95 %), {bolt_n['max']:.1f} N at most",
        f"peak of all     {total_n['p95']:.1f} N (95 %), {total_n['max']:.1f} N at most",
    ]
    failures = document["failures"]
    lines += [f"  seed {item['seed']}: {item['reason']}" for item in failures[:LISTED]]
    if len(failures) > LISTED:
        lines.append(f"  and {len(failures) - LISTED} more; --json has all")
    return "\n".join(lines)


def _progress(runs: int) -> Callable[[DockOutcome], None]:
    began = told = time.monotonic()
    done = failed = 0

    def on_dock(outcome: DockOutcome) -> None:
        nonlocal told, done, failed
        done, failed = done + 1, failed + (not outcome.succeeded)
        now = time.monotonic()
        if now - told >= TOLD_EVERY_S or done == runs:
            told = now
            _tell(f"{done} of {runs} docks, {failed} failed, {now - began:.0f} s")

    return on_dock


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
