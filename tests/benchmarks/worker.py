"""One pipeline of Python in a process of its own: time and memory apart from imports and reading.

    python -m tests.benchmarks.worker KIND FOLDER OPTIONS REPEATS

prints one JSON document: of each repeat wall_s, cpu_s and, of the main thread alone, thread_s; peak_mib; and what was
measured.
"""

from __future__ import annotations

import gc
import json
import pickle
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cloud = NDArray[np.float32]
Measure = Callable[[Cloud], dict[str, Any]]


def pipeline(kind: str, folder: Path, options: Mapping[str, Any]) -> Measure:
    """The pipeline, imported and told about the part; what remains is to give it the cloud."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    if kind == "sum":
        return lambda cloud: {"sum": cloud.astype(np.float64).sum(axis=0).tolist()}
    if kind == "open3d":
        from tests.benchmarks import with_open3d

        return lambda cloud: with_open3d.measure(cloud, job, **options)
    with (folder / "part.pickle").open("rb") as file:
        part = pickle.load(file)
    return lambda cloud: ours(_cut(cloud, job) if options.get("cut") else cloud, part)


def ours(cloud: Cloud, part: Any) -> dict[str, Any]:
    """The vision core, told the part's sizes and nothing else; a refusal is a result."""
    from cellctl.vision.measure import measure_part
    from cellctl.vision.part import Refused

    try:
        measured = measure_part(cloud, part)
    except Refused as refused:
        return {"refused": str(refused)}
    centres = [None if one.center_mm is None else one.center_mm.tolist() for one in measured.features]
    x_axis = measured.T_frame_part[:3, 0].tolist()
    return {"normal": measured.face.normal.tolist(), "centres": centres, "x_axis": x_axis}


def _cut(cloud: Cloud, job: Mapping[str, Any]) -> Cloud:
    """What lies near the working distance, the rest NaN."""
    z = cloud[..., 2:]
    return np.where((z > job["near_mm"]) & (z < job["far_mm"]), cloud, np.float32(np.nan))


def laid_out(cloud: Cloud, layout: str) -> Cloud:
    """The grid as it is, its valid points in the scanner's order, or shuffled."""
    if layout == "grid":
        return cloud
    points = cloud.reshape(-1, 3)
    points = points[np.isfinite(points[:, 0])]
    return np.random.default_rng(0).permutation(points) if layout == "shuffled" else points


def resident_kib(key: str) -> int:
    """A line of this process's own status: VmRSS at this moment, VmHWM at most."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith(f"{key}:"))


def main(argv: list[str]) -> None:
    """Measure the cloud of FOLDER again and again."""
    kind, folder, options, repeats = argv[0], Path(argv[1]), json.loads(argv[2]), int(argv[3])
    layout = options.pop("layout")
    if kind == "ours":
        import cellctl.vision.measure  # noqa: F401
    measure = pipeline(kind, folder, options)
    gc.collect()
    before = resident_kib("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak from here on, imports apart
    cloud: Cloud = np.load(folder / f"{layout}.npy")
    seconds: dict[str, list[float]] = {"wall_s": [], "cpu_s": [], "thread_s": []}
    clocks = dict(zip(seconds, (time.perf_counter, time.process_time, time.thread_time), strict=True))
    peak = 0
    for _ in range(repeats):
        begin = {name: clock() for name, clock in clocks.items()}
        result = measure(cloud)
        for name, clock in clocks.items():
            seconds[name].append(clock() - begin[name])
        peak = peak or resident_kib("VmHWM")
    print(json.dumps({**seconds, "peak_mib": (peak - before) / 1024, **result}))


if __name__ == "__main__":
    main(sys.argv[1:])
