"""The pipelines that are compared, each run in a process of its own."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np

from tests.benchmarks import worker
from tests.benchmarks.scenes import Scene

ROOT = Path(__file__).parents[2]
PCL = ROOT / "build" / "pcl_pipeline"

Layout = Literal["grid", "list", "shuffled"]


@dataclass(frozen=True, slots=True)
class Pipeline:
    """What is run: with statistical outlier removal, on a view that was cut along z, through the bores' walls."""

    label: str
    kind: Literal["sum", "ours", "open3d", "pcl"]
    layout: Layout = "grid"
    sor: bool = False
    cut: bool = False
    wall: bool = False
    threads: int = 1


@dataclass(frozen=True, slots=True)
class Taken:
    """What one process needed, medians over its repeats, and what it measured.

    `seconds` is what others on the machine do not disturb: CPU time with one thread; with two, that of the main thread,
    or half of all where that is more, which is the least that the wall time can be.
    """

    seconds: float
    wall_s: float
    cpu_s: float
    peak_mib: float
    result: Mapping[str, Any]


def store(scene: Scene, folder: Path) -> None:
    """The scene as files for all pipelines."""
    folder.mkdir(parents=True, exist_ok=True)
    for layout in ("grid", "list", "shuffled"):
        np.save(folder / f"{layout}.npy", worker.laid_out(scene.cloud, layout))
    scene.cloud.tofile(folder / "cloud.f32")
    job = scene.job()
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    holes = [[*place, mouth] for place, mouth in zip(job["places_mm"], job["mouth_radii_mm"], strict=True)]
    rows = [[job["near_mm"], job["far_mm"]], *job["taught"], [scene.part.count], *holes]
    text = "\n".join(" ".join(repr(number) for number in row) for row in rows)
    (folder / "job.txt").write_text(text + "\n", encoding="ascii")
    (folder / "part.pickle").write_bytes(pickle.dumps(scene.part))


def run(pipeline: Pipeline, folder: Path, repeats: int) -> Taken:
    """One process on the stored scene. Raises SystemExit with its words where it fails."""
    env = os.environ | {name: str(pipeline.threads) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    env["OMP_WAIT_POLICY"] = "passive"  # a thread that waits for the other takes no CPU time
    cores = sorted(os.sched_getaffinity(0))[-pipeline.threads :]
    done = subprocess.run(
        _command(pipeline, folder, repeats),
        cwd=ROOT, env=env, capture_output=True, text=True, preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{pipeline.label} failed: {done.stderr.strip()}")
    result = json.loads(done.stdout)
    wall, cpu, thread = (median(result.pop(name)) for name in ("wall_s", "cpu_s", "thread_s"))
    seconds = cpu if pipeline.threads == 1 else max(thread, cpu / pipeline.threads)
    return Taken(seconds, wall, cpu, result.pop("peak_mib"), result)


def _command(pipeline: Pipeline, folder: Path, repeats: int) -> Sequence[str]:
    if pipeline.kind == "pcl":
        flags = [str(int(flag)) for flag in (pipeline.sor, pipeline.cut)]
        return [str(PCL), f"{folder}/cloud.f32", f"{folder}/job.txt", str(repeats), str(pipeline.threads), *flags]
    options = {"layout": pipeline.layout} | _options(pipeline)
    module = [sys.executable, "-m", "tests.benchmarks.worker"]
    return [*module, pipeline.kind, str(folder), json.dumps(options), str(repeats)]


def _options(pipeline: Pipeline) -> dict[str, bool]:
    names = {"ours": ("cut",), "open3d": ("sor", "cut", "wall")}.get(pipeline.kind, ())
    return {name: getattr(pipeline, name) for name in names}


def result_of(pipeline: Pipeline, scene: Scene, folder: Path) -> Mapping[str, Any]:
    """What a pipeline measures in a stored scene where neither time nor memory is asked: in this process if it can."""
    if pipeline.kind == "pcl":
        return run(pipeline, folder, 1).result
    measure = worker.pipeline(pipeline.kind, folder, _options(pipeline))
    return measure(worker.laid_out(scene.cloud, pipeline.layout))
