"""Everything at once, see `scenes.stressed`: hole centres of ours against the better library pipeline."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.accuracy import COMPARED, WALL, of_scene
from tests.benchmarks.errors import Errors, pooled
from tests.benchmarks.scenes import stressed
from tests.benchmarks.timing import GRID, OPEN3D, PCL

OUTLINES = (PCL.label, OPEN3D.label)


def over_seeds(work: Path, seeds: int, first: int = 0) -> dict[str, Any]:
    """Pooled errors over the scenes of `seeds` seeds from `first`, and in how many ours is at most half the better."""
    found: dict[str, list[Errors]] = {one.label: [] for one in COMPARED}
    halves, gross = {"outlines": 0, "with walls": 0}, []
    for seed in range(first, first + seeds):
        of = of_scene(stressed(seed), work)
        for label, error in of.items():
            found[label].append(error)
        if of[GRID.label].gross or of[GRID.label].refused:
            gross.append({"seed": seed, "gross": of[GRID.label].gross, "refused": of[GRID.label].refused})
        for name, rivals in (("outlines", OUTLINES), ("with walls", (*OUTLINES, WALL.label))):
            halves[name] += _rms(of[GRID.label]) <= 0.5 * min(_rms(of[label]) for label in rivals)
    rows = {label: pooled(many) for label, many in found.items()}
    return {
        "seeds": [first, first + seeds - 1],
        "rows": rows,
        "at_most_half": halves,
        "ratio": {
            "outlines": _ratio(rows, OUTLINES),
            "with walls": _ratio(rows, (*OUTLINES, WALL.label)),
        },
        "ours_failed": gross,
    }


def _rms(error: Errors) -> float:
    return float(np.sqrt(np.mean(error.centres_um**2))) if len(error.centres_um) else float("inf")


def _ratio(rows: Mapping[str, Mapping[str, Any]], rivals: tuple[str, ...]) -> float:
    """Pooled rms of ours over that of the better rival."""
    return float(rows[GRID.label]["centre_rms_um"] / min(rows[label]["centre_rms_um"] for label in rivals))
