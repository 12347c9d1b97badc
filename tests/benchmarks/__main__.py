"""Benchmarks as ratios within one run: `python -m tests.benchmarks [--only PART] [--seeds N] [--docs FOLDER]`.

Each part replaces its own entry in FOLDER/figures/bench.json; the document and the plot beside it are written from that
file. `make bench` compiles the PCL pipeline first. Parts: time, bolts and studs (see `timing`), accuracy, bound,
stress, run, reaction.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from cellctl.studies.figures import provenance
from tests.benchmarks import accuracy, against_bound, stress, timing
from tests.benchmarks.pipelines import PCL, ROOT
from tests.benchmarks.reaction import reaction
from tests.benchmarks.report import plot, report
from tests.benchmarks.whole_run import whole_run

Part = Callable[[Path], dict[str, Any]]
ACCURACY_SEEDS, STRESS_SEEDS = 5, 30
WITH_PCL = {"time", "bolts", "accuracy", "stress"}
"""Parts that run the PCL pipeline."""
BOUND_CLOUDS = {100_000: 100, 300_000: 50, 1_000_000: 20}


def parts(seeds: int | None, first: int, figures: Path) -> dict[str, Part]:
    """All of them by name; each gets a folder for its clouds. What is too long for bench.json goes beside it."""
    return {
        "time": timing.over_points,
        "bolts": timing.over_bolts,
        "studs": timing.on_studs,
        "accuracy": partial(accuracy.over_seeds, seeds=seeds or ACCURACY_SEEDS),
        "bound": partial(bound, seeds=seeds, first=first),
        "stress": partial(stress.over_seeds, seeds=seeds or STRESS_SEEDS, first=first),
        "run": whole_run,
        "reaction": partial(reaction, delays=figures / "reaction_delays.json"),
    }


def bound(work: Path, seeds: int | None, first: int) -> dict[str, Any]:
    """Accuracy in units of the bound at each number of points, see `against_bound`."""
    return {"sizes": [
        against_bound.over_seeds(points, seeds or clouds, first) for points, clouds in BOUND_CLOUDS.items()
    ]}  # fmt: skip


def cpu_s() -> float:
    """CPU seconds of this process and of those that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    known = sorted(parts(None, 0, ROOT))
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--only", action="append", choices=known)
    parser.add_argument("--seeds", type=int, help="clouds of accuracy, bound and stress")
    parser.add_argument("--first", type=int, default=0, help="first seed of bound and stress")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    args = parser.parse_args(argv)
    if not PCL.exists() and set(args.only or known) & WITH_PCL:
        parser.error(f"{PCL.relative_to(ROOT)} is missing: `make bench` compiles it")
    path = args.docs / "figures" / "bench.json"
    figures = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name, part in parts(args.seeds, args.first, path.parent).items():
        if args.only and name not in args.only:
            continue
        print(f"{name} ...", flush=True)
        begin_s = cpu_s()
        with tempfile.TemporaryDirectory() as folder:
            result = part(Path(folder))
        given = [f"--{one} {getattr(args, one)}" for one in ("seeds", "first") if getattr(args, one)]
        command = f'make bench ARGS="{" ".join(["--only", name, *given])}"'
        figures[name] = provenance([command], ROOT) | {"cpu_s": cpu_s() - begin_s, "result": result}
        _write(path, figures)
    print(report(figures))
    return 0


def _write(path: Path, figures: dict[str, Any]) -> None:
    """Figures, document and plot."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    (path.parent / "bench_time.svg").write_text(plot(figures), encoding="utf-8")
    (path.parents[1] / "benchmarks.md").write_text(report(figures), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
