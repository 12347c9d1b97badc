"""Time and memory as ratios: over points, over bolts, and our own on studs.

The unit is the sum pass, `points.astype(float64).sum(axis=0)` on the valid points as C-ordered (N, 3) float32, in a
process of its own between the others. Each pipeline runs in its own process, one after the other, the order reversed
from round to round; medians over the rounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from tests.benchmarks.errors import errors, pooled
from tests.benchmarks.pipelines import Pipeline, Taken, run, store
from tests.benchmarks.scenes import Scene, joint, plain, studs

SUM = Pipeline("sum pass", "sum", "list")
GRID = Pipeline("ours", "ours")
LISTS = (Pipeline("ours, list", "ours", "list"), Pipeline("ours, shuffled list", "ours", "shuffled"))
PCL, OPEN3D = Pipeline("PCL", "pcl"), Pipeline("Open3D", "open3d")
WITH_SOR = tuple(replace(one, label=f"{one.label} + SOR", sor=True) for one in (PCL, OPEN3D))
TWO_THREADS = tuple(replace(one, label=f"{one.label}, 2 threads", threads=2) for one in (PCL, OPEN3D, *WITH_SOR))
CUT = tuple(replace(one, label=f"{one.label}, view cut", cut=True) for one in (GRID, PCL, OPEN3D, *WITH_SOR))
ALL_SIZES = (GRID, *LISTS, PCL, OPEN3D, *WITH_SOR)

SCAN = 1_000_000
ROUNDS_OF = {100_000: 3, 300_000: 3, SCAN: 3, 3_000_000: 1}
"""Rounds for each number of points."""
BOLTS = (8, 36, 96)
ROUNDS = 2
SUM_REPEATS, REPEATS, REPEATS_WITH_SOR = 15, 3, 1
SEED = 1


def over_points(work: Path) -> dict[str, Any]:
    """All pipelines on scans of the default joint; one and two threads, and on a cut view, at a million points."""
    sizes = [
        compared(plain(points, SEED), ALL_SIZES + (TWO_THREADS + CUT if points == SCAN else ()), work, times)
        for points, times in ROUNDS_OF.items()
    ]
    return {
        "seed": SEED,
        "sizes": sizes,
        "exponents": {
            one.label: exponent([size["points"] for size in sizes], [_seconds(size, one) for size in sizes])
            for one in ALL_SIZES
        },
        "ratios": [ratios(size["rows"]) | {"points": size["points"]} for size in sizes],
    }


def over_bolts(work: Path) -> dict[str, Any]:
    """A million points on joints that differ in the number of their holes alone, small enough for 96 to fit."""
    chosen = (GRID, LISTS[0], PCL, OPEN3D)
    counts = [
        compared(plain(SCAN, SEED, joint(count, 5.0, 6.2)), chosen, work, ROUNDS) | {"bolts": count} for count in BOLTS
    ]
    return {"seed": SEED, "counts": counts, "exponents": {
        one.label: exponent(BOLTS, [_seconds(count, one) for count in counts]) for one in chosen
    }}  # fmt: skip


def on_studs(work: Path) -> dict[str, Any]:
    """Our own time and memory on scans of studs; the libraries have nothing to compare."""
    sizes = [compared(studs(points, SEED), (GRID, LISTS[0]), work, ROUNDS) for points in (300_000, SCAN)]
    return {"seed": SEED, "sizes": sizes}


def compared(scene: Scene, pipelines: Sequence[Pipeline], folder: Path, times: int) -> dict[str, Any]:
    """Times in sum passes, memory and errors of each pipeline on one scene, in `times` rounds."""
    store(scene, folder)
    taken = rounds([SUM, *pipelines], folder, times)
    unit = taken.pop(SUM.label)
    rows = {
        label: {
            "passes": one.seconds / unit.seconds,
            "seconds": one.seconds,
            "wall_s": one.wall_s,
            "cpu_s": one.cpu_s,
            "peak_mib": one.peak_mib,
            **pooled([errors(one.result, scene)]),
        }
        for label, one in taken.items()
    }
    return {"points": scene.points, "unit_s": unit.seconds, "busy": unit.wall_s / unit.cpu_s, "rows": rows}


def rounds(pipelines: Sequence[Pipeline], folder: Path, times: int) -> dict[str, Taken]:
    """Every pipeline `times` times, the order reversed each time; medians by label."""
    taken: dict[str, list[Taken]] = {one.label: [] for one in pipelines}
    for number in range(times):
        for one in pipelines[:: -1 if number % 2 else 1]:
            repeats = SUM_REPEATS if one.kind == "sum" else REPEATS_WITH_SOR if one.sor else REPEATS
            taken[one.label].append(run(one, folder, repeats))
    return {label: _middle(many) for label, many in taken.items()}


def _middle(many: Sequence[Taken]) -> Taken:
    names = ("seconds", "wall_s", "cpu_s", "peak_mib")
    return Taken(**{name: median(getattr(one, name) for one in many) for name in names}, result=many[0].result)


def ratios(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Ours on the grid against the fastest library pipeline on the same view, without and with outlier removal."""
    one_thread = (PCL, OPEN3D, *WITH_SOR)
    found: dict[str, Any] = {}
    for suffix, mine, rivals in (("", GRID, one_thread), ("_2_threads", GRID, TWO_THREADS), ("", CUT[0], CUT[1:])):
        for sor in (False, True):
            there = [one.label for one in rivals if one.sor == sor and one.label in rows]
            if there:
                fastest = min(there, key=lambda label: float(rows[label]["passes"]))
                name = f"{'cut_' if mine.cut else ''}{'with' if sor else 'without'}_sor{suffix}"
                found[name] = {"fastest": fastest, "ratio": rows[mine.label]["passes"] / rows[fastest]["passes"]}
    return found


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log time over log size by least squares: 1 is linear."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def _seconds(table: Mapping[str, Any], pipeline: Pipeline) -> float:
    return float(table["rows"][pipeline.label]["seconds"])
