"""Results that stand in docs/figures: each with the command, the commit and the machine that gave it.

One JSON file holds the entries of one study by command; a Markdown table beside it is written from it.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

COLUMNS = (
    "command",
    "runs",
    "succeeded",
    "95 % interval",
    "inserted",
    "below 10 N",
    "refused",
    "peak stud N",
    "commit",
)


def provenance(command: Sequence[str], root: Path) -> dict[str, Any]:
    """What a result depends on beside its input. `commit` ends in "+" where the working tree was changed."""
    return {
        "command": " ".join(command),
        "commit": commit_of(root),
        "machine": {
            "cpu": _cpu(),
            "cores": os.cpu_count(),
            "system": f"{platform.system()} {platform.machine()}",
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
    }


def commit_of(root: Path) -> str:
    """Short hash of the commit checked out at `root`; "unknown" where that is no repository."""
    try:
        short = _git(root, "rev-parse", "--short", "HEAD")
        changed = _git(
            root, "status", "--porcelain", "--untracked-files=no", "--", "hal", "cellctl", "recipes", "deploy"
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return short + ("+" if changed else "")


def add_figure(path: Path, entry: Mapping[str, Any]) -> None:
    """Put `entry` into the file at `path`, in the place of an earlier one of the same command, and write the table.

    Raises OSError, or ValueError where the file holds something else.
    """
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    if not isinstance(entries, list):
        raise ValueError(f"{path} is not a list of results")
    others = [one for one in entries if one["command"] != entry["command"]]
    entries = sorted([*others, dict(entry)], key=lambda one: str(one["command"]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(entries, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    path.with_suffix(".md").write_text(table(entries), encoding="utf-8")


def table(entries: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row for each result of `study dock`, then machines and failures."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(_row(entry)) + " |" for entry in entries]
    machines = sorted({_machine(entry) for entry in entries})
    lines += ["", *(f"Machine: {machine}." for machine in machines)]
    for entry in entries:
        if entry["pose"] == "by sight":
            lines += ["", f"`{entry['command']}`, {entry['cpu_s'] / entry['runs']:.1f} s of one core a dock:", ""]
            lines += [f"* seed {one['seed']}: {one['reason']}" for one in entry["failures"]] or ["* no failure"]
            lines += _errors(entry)
    return "\n".join(lines) + "\n"


def _row(entry: Mapping[str, Any]) -> list[str]:
    low, high = entry["interval95"]
    peak = entry["peak_bolt_n"]
    return [
        f"`{entry['command']}`",
        str(entry["runs"]),
        f"{entry['succeeded']} ({100 * entry['rate']:.1f} %)",
        f"{100 * low:.1f} to {100 * high:.1f} %",
        f"{100 * entry['inserted_rate']:.1f} %",
        f"{100 * entry['force_ok_rate']:.1f} %",
        str(entry["refused"]),
        f"{peak['p95']:.1f} (95 %), {peak['max']:.1f} (max)",
        str(entry["commit"]),
    ]


def _errors(entry: Mapping[str, Any]) -> list[str]:
    seen = entry.get("alignment")
    if seen is None:
        return []
    lines = []
    for name, unit in (("theta", "deg"), ("xy", "mm")):
        true, estimate = seen[f"{name}_error_{unit}"], seen[f"{name}_estimate_error_{unit}"]
        lines.append(
            f"* {name} at entry off by {true['rms']:.4f} {unit} rms, {true['max']:.4f} at most; its estimate by "
            f"{estimate['rms']:.4f} rms, believed sigma {seen[f'sigma_{name}_{unit}']:.4f}"
        )
    loops = seen["loops"]
    return [*lines, f"* {loops['mean']:.2f} alignment loops on average, {loops['max']} at most (xy: length of x and y)"]


def _machine(entry: Mapping[str, Any]) -> str:
    machine = entry["machine"]
    return f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}, Python {machine['python']}"


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True, timeout=10.0)
    return done.stdout.strip()


def _cpu() -> str:
    """Model of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
