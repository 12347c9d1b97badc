"""Accuracy on white noise: ours and the library pipelines on the same clouds, over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.benchmarks.errors import Errors, errors, pooled
from tests.benchmarks.pipelines import Pipeline, result_of, store
from tests.benchmarks.scenes import Scene, plain
from tests.benchmarks.timing import GRID, LISTS, OPEN3D, PCL

WALL = Pipeline("Open3D, bore walls", "open3d", wall=True)
COMPARED = (GRID, LISTS[0], PCL, OPEN3D, WALL)
POINTS = (100_000, 300_000, 1_000_000)


def over_seeds(work: Path, seeds: int) -> dict[str, Any]:
    """Rms of hole centre, clocking and normal over `seeds` clouds of each size of the default joint."""
    sizes = []
    for points in POINTS:
        found: dict[str, list[Errors]] = {one.label: [] for one in COMPARED}
        for seed in range(seeds):
            for label, error in of_scene(plain(points, seed), work).items():
                found[label].append(error)
        sizes.append({"points": points, "rows": {label: pooled(many) for label, many in found.items()}})
    return {"seeds": [0, seeds - 1], "sizes": sizes}


def of_scene(scene: Scene, work: Path, pipelines: Sequence[Pipeline] = COMPARED) -> Mapping[str, Errors]:
    """Errors of each pipeline on one scene, by label."""
    store(scene, work)
    return {one.label: errors(result_of(one, scene, work), scene) for one in pipelines}
