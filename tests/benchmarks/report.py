"""docs/benchmarks.md and its plot, written from docs/figures/bench.json and from nothing else. Text out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cellctl.records.figure import HEIGHT, WIDTH, Line, chart
from tests.benchmarks.stress import OUTLINES
from tests.benchmarks.timing import GRID, LISTS, OPEN3D, PCL, SCAN, WITH_SOR

Json = Mapping[str, Any]
HEAD = """# Benchmarks

Written by `make bench`, every figure a ratio within its own run; `make bench ARGS="--only time"` measures one part
again and leaves the others. The numbers are in [bench.json](figures/bench.json).

* The unit is the sum pass: `points.astype(float64).sum(axis=0)` on the scan's valid points, C-ordered (N, 3) float32,
  one thread, median of 15.
* Each pipeline runs in a process of its own, one after the other, in alternating order; imports and reading of files
  are not counted. One thread: CPU time, pinned to one core. Two threads: CPU time of the main thread, or half of all
  where that is more: the least that the wall time can be.
* Memory is the peak during the first measurement above what the process held after its imports; the cloud counts.
* The library pipelines are in `tests/benchmarks/with_open3d.py` and `tests/benchmarks/pcl_pipeline.cpp`: planes by
  RANSAC until one lies where the part was taught, then for each hole a circle by least squares through the outline of
  the face around its nominal place. They are told the pose to 0.3 mm and 0.2 degrees; ours is told the part's sizes
  only.
* View cut: everything beyond 25 mm from the taught distance is thrown away first, for ours too. SOR: statistical
  outlier removal, 20 neighbours, 2 sigma. Bore walls: Open3D, circles through the walls of the bores in place of the
  outline, a stronger recipe than the usual one, shown for accuracy only.
"""
STRESS = """Sigma 0.05 mm shared over 3 pixels, ripple 0.02 mm, 6 % outliers, clutter, a fifth of the view missing, tilt
3 degrees, sizes, counts and angles at random. Holes with at least half of their mouth in view count; gross: a centre
off by more than 0.25 mm."""

REACTION = """From the last byte of a sample above the trip on the pty to the quick stop at the CAN hub; 1000 samples a
second; none within 5 s counts as 5 s. The delays of every trial are in
[reaction_delays.json](figures/reaction_delays.json).

* Bare loop: one reader of the pty that writes one line to the hub's socket, with the guard's priority; the floor. The
  kernel hands bytes of a pty on in a worker thread of ordinary priority, which both have to wait for.
* Guard in its process: `python -m hal.guard`. As with the bare loop, service and vision are processes of their own,
  vision at the niceness of the controller's worker; both ways are measured in turns.
* Guard in a thread: the same guard with the same priority in one interpreter with something else; beside our vision,
  beside Open3D's calls, which hold the interpreter, or beside our vision and the service that is asked."""
WAYS = {
    "floor": "bare loop",
    "process": "guard in its process",
    "thread": "thread beside vision",
    "together": "thread beside vision and service",
    "open3d": "thread beside Open3D",
}


def report(figures: Json) -> str:
    """The document, of the parts that are there."""
    writers: dict[str, Callable[[Json], list[str]]] = {
        "time": _time,
        "bolts": _bolts,
        "studs": _studs,
        "accuracy": _accuracy,
        "bound": _bound,
        "stress": _stress,
        "run": _run,
        "reaction": _reaction,
    }
    lines = [HEAD]
    for name, writer in writers.items():
        if name in figures:
            lines += [*writer(figures[name]["result"]), "", _source(figures[name]), ""]
    return "\n".join(lines).rstrip() + "\n"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Markdown."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def number(value: float | None, digits: int = 3) -> str:
    """Significant digits, no exponent; a dash for None."""
    if value is None:
        return "-"
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text else f"{float(text):.12f}".rstrip("0") if "e-" in text else text


def _source(section: Json) -> str:
    machine = section["machine"]
    return (
        f"`{section['command']}`, commit {section['commit']}, {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['system']}, Python {machine['python']}, NumPy {machine['numpy']}, {section['cpu_s']:.0f} s of CPU."
    )


def _millions(points: float) -> str:
    return f"{points / 1e6:.2g} M"


def _time(result: Json) -> list[str]:
    sizes, slopes = result["sizes"], result["exponents"]
    heads = [_millions(size["points"]) for size in sizes]
    rows = [
        [label, *(number(size["rows"][label]["passes"]) for size in sizes), f"{slope:.2f}"]
        for label, slope in slopes.items()
    ]
    names = {
        "without_sor": "without SOR",
        "with_sor": "with SOR",
        "without_sor_2_threads": "without SOR, 2 threads for the library",
        "with_sor_2_threads": "with SOR, 2 threads for the library",
        "cut_without_sor": "view cut, without SOR",
        "cut_with_sor": "view cut, with SOR",
    }
    over = [[text, *(_over(one.get(name)) for one in result["ratios"])] for name, text in names.items()]
    scan = _scan(result)
    return [
        *("## Time over points", ""),
        f"36 holes of 8.5 mm, sigma 0.03 mm, 2 % outliers, seed {result['seed']}. Exponent: slope of log time over log",
        "points, 1 is linear.",
        *("", *table(["sum passes", *heads, "exponent"], rows)),
        *("", "Ours on the grid, one thread, over the fastest library pipeline:", ""),
        *table(["ratio", *heads], over),
        *("", "![time over points and bolts](figures/bench_time.svg)", ""),
        *(f"## One scan of {_millions(scan['points'])} points", ""),
        *table(
            ["pipeline", "sum passes", "ms", "peak MiB", "centre rms um", "clocking deg", "normal deg", "found"],
            [[label, *_cost(row), *_angles(row)] for label, row in scan["rows"].items()],
        ),
        *("", f"Sum pass {1e3 * scan['unit_s']:.1f} ms of CPU time, {scan['busy']:.2f} times that by the wall clock."),
    ]


def _scan(result: Json) -> Json:
    """The table of the scan of a million points."""
    return min(result["sizes"], key=lambda size: abs(size["points"] - SCAN))


def _over(one: Json | None) -> str:
    return "-" if one is None else f"{one['ratio']:.3f} ({one['fastest']})"


def _cost(row: Json) -> list[str]:
    return [number(row["passes"]), f"{1e3 * row['seconds']:.0f}", f"{row['peak_mib']:.0f}"]


def _angles(row: Json) -> list[str]:
    angles = [number(row["clocking_deg"], 2), number(row["normal_deg"], 2)]
    return [number(row["centre_rms_um"]), *angles, f"{row['found']} of {row['seen']}"]


def _bolts(result: Json) -> list[str]:
    counts = result["counts"]
    rows = [
        [label, *(number(count["rows"][label]["passes"]) for count in counts), f"{slope:.2f}"]
        for label, slope in result["exponents"].items()
    ]
    heads = [f"{count['bolts']} bolts" for count in counts]
    intro = f"Holes of 5 mm at {_millions(counts[0]['points'])} points, seed {result['seed']}."
    return ["## Time over bolts", "", intro, "", *table(["sum passes", *heads, "exponent"], rows)]


def _studs(result: Json) -> list[str]:
    rows = [
        [f"{label}, {_millions(size['points'])}", *_cost(row), f"{row['found']} of {row['seen']}"]
        for size in result["sizes"]
        for label, row in size["rows"].items()
    ]
    intro = f"36 studs M8x1.25 as the twin's scanner shows them, seed {result['seed']}."
    return ["## Studs", "", intro, "", *table(["pipeline", "sum passes", "ms", "peak MiB", "found"], rows)]


def _accuracy(result: Json) -> list[str]:
    first, last = result["seeds"]
    lines = ["## Accuracy", "", f"The joint of 36 holes, sigma 0.03 mm, 2 % outliers, seeds {first} to {last}; rms."]
    for size in result["sizes"]:
        rows = [[label, *_angles(row), str(row["gross"])] for label, row in size["rows"].items()]
        head = [f"{_millions(size['points'])} points", "centre um", "clocking deg", "normal deg", "found", "gross"]
        lines += ["", *table(head, rows)]
    return lines


def _bound(result: Json) -> list[str]:
    names = {
        "hole_centre": "hole centre",
        "hole_radius": "hole radius",
        "clocking": "clocking",
        "face_normal": "face normal",
        "face_offset_um": "face offset, um",
    }
    sizes = result["sizes"]
    heads = [f"{_millions(one['points'])}, seeds {one['seeds'][0]} to {one['seeds'][1]}" for one in sizes]
    rows = [[text, *(_interval(one["ratios"][name]) for one in sizes)] for name, text in names.items()]
    rows.append(["clouds refused", *(str(len(one["refused"])) for one in sizes)])
    rows.append(["clouds with a hole missing", *(str(len(one["incomplete"])) for one in sizes)])
    return [
        *("## Accuracy against the bound", ""),
        "Joints drawn at random, white noise of 0.03 mm, 2 % outliers: rms of the error over the cloud's own bound",
        "(Fisher information of the points delivered, labels known), with its 95 % interval.",
        *("", *table(["error over bound", *heads], rows)),
    ]


def _interval(ratio: Json) -> str:
    return f"{ratio['rms']:.2f} ({ratio['low']:.2f} to {ratio['high']:.2f})"


def _stress(result: Json) -> list[str]:
    first, last = result["seeds"]
    total, half, ratio = last - first + 1, result["at_most_half"], result["ratio"]
    mine = result["rows"][GRID.label]["centre_rms_um"]
    rows = [
        [
            *(label, *_angles(row), number(row["centre_worst_um"]), str(row["gross"]), str(len(row["refused"]))),
            f"{mine / row['centre_rms_um']:.2f}",
        ]
        for label, row in result["rows"].items()
    ]
    head = ["pipeline", "centre rms um", "clocking deg", "normal deg", "found", "worst um", "gross", "refused"]
    failed = [
        f"* seed {one['seed']}: {one['refused'] or str(one['gross']) + ' gross'}" for one in result["ours_failed"]
    ]
    return [
        *("## Stress", "", STRESS, ""),
        *table([*head, "ours over it"], rows),
        "",
        f"Seeds {first} to {last}. Ours over the better of {' and '.join(OUTLINES)}:",
        f"{ratio['outlines']:.2f} pooled, at most half in {half['outlines']} of {total} clouds; with the bore walls",
        f"among them {ratio['with walls']:.2f}, {half['with walls']} of {total}.",
        *(["", *failed] if failed else []),
    ]


def _run(result: Json) -> list[str]:
    rows = [[name, number(row["passes"]), number(row["seconds"])] for name, row in result["rows"].items()]
    intro = f"The joint of 36 bolts on the twin, {_millions(result['points'])} points a scan, seed {result['seed']}."
    return ["## A whole run", "", intro, "", *table(["CPU", "sum passes", "s"], rows)]


def _reaction(result: Json) -> list[str]:
    rows = [
        [
            name,
            *(number(result[key][one]) for one in ("p50_ms", "p99_ms", "max_ms")),
            *(str(result[key]["trials"]), f"{result[key]['answered_per_s']:.0f}"),
        ]
        for key, name in WAYS.items()
    ]
    threads = [f"{number(result[f'{key}_to_process'])} ({WAYS[key]})" for key in ("thread", "together", "open3d")]
    return [
        *("## Reaction", "", REACTION, ""),
        f"Asked {result['asked_per_s']:.0f} times a second; vision on {_millions(result['points'])} points;",
        f"load average before the run {result['load_average_before']:.2f}.",
        *("", *table(["way", "p50 ms", "p99 ms", "max ms", "trials", "answers/s"], rows), ""),
        f"p99 of the guard in its process: {number(result['process_to_floor'])} times the floor. p99 of the guard in a",
        f"thread over that: {', '.join(threads)}.",
        f"Until the bare loop has read the sample, p99: {number(result['floor_reading_p99_ms'])} ms.",
    ]


def plot(figures: Json) -> str:
    """Time over points without and with outlier removal, and over bolts: a self-contained SVG."""
    charts = []
    if "time" in figures:
        sizes = figures["time"]["result"]["sizes"]
        millions = [size["points"] / 1e6 for size in sizes]
        unit_s = _scan(figures["time"]["result"])["unit_s"]
        for chosen in ((GRID, LISTS[0], PCL, OPEN3D), (GRID, *WITH_SOR)):
            lines = [
                Line(one.label, millions, [size["rows"][one.label]["seconds"] / unit_s for size in sizes])
                for one in chosen
            ]
            charts.append(chart(lines, x_label="million points", y_label="sum passes (1 M)"))
    if "bolts" in figures:
        counts = figures["bolts"]["result"]["counts"]
        lines = [
            Line(label, [count["bolts"] for count in counts], [count["rows"][label]["passes"] for count in counts])
            for label in counts[0]["rows"]
        ]
        charts.append(chart(lines, x_label="bolts, 1 M points", y_label="sum passes"))
    placed = [
        one.replace("<svg ", f'<svg y="{i * (HEIGHT + 12):.0f}" width="{WIDTH:.0f}" height="{HEIGHT:.0f}" ', 1)
        for i, one in enumerate(charts)
    ]
    size = f"0 0 {WIDTH:.0f} {max(1, len(charts)) * (HEIGHT + 12):.0f}"
    ground = '<rect width="100%" height="100%" fill="#fff"/>'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{size}" font-family="sans-serif">'
    return f"{head}{ground}{''.join(placed)}</svg>\n"
