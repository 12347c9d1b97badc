"""Whole assemblies over the wire in processes of their own: `cellctl simulate` and the service beside it.

    python -m tests.journeys.two_processes --seeds 10 [--first 1] [--recipe wire_bench] [--figures docs/figures]

One seed after the other in real time, until one is not accepted, is not good in truth, or does not come to the same as
the fake cell. Exit 0 when all are.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path
from typing import Any

from cellctl.recipe import load_recipe
from cellctl.records.summary import summarise, value_of
from cellctl.records.verify import read_record, verify
from cellctl.studies.figures import provenance
from hal.config import CalibrationEntry, load_cell
from tests.journeys.agreement import Agreement, agreement
from tests.journeys.twin_runs import ROOT

CELL = ROOT / "deploy" / "cell.wire.toml"
END_S = 15.0
WHOLE_RUN_S = 3600.0


@dataclass(frozen=True, slots=True)
class WireRun:
    """How one run ended, `wall_s` after the service was up; `wrong` is empty where it was accepted, is good in truth,
    and its record says so."""

    seed: int
    verdict: str
    wall_s: float
    worst_stud_n: float
    gap_mm: float
    preload_n: tuple[float, float]
    against_fake: Agreement | None
    wrong: tuple[str, ...]


@contextmanager
def simulated(cell: Path, recipe: str, seed: int, truth: Path) -> Iterator[None]:
    """The devices of `cell` in a process of their own, ready when this begins; ended by SIGTERM."""
    command = [sys.executable, "-m", "cellctl", "simulate", "--cell", str(cell), "--seed", str(seed)]
    command += ["--recipe", str(ROOT / "recipes" / f"{recipe}.toml"), "--truth", str(truth)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if "Ctrl-C ends" in line:
                    break
            else:
                raise RuntimeError(f"the simulators ended with exit {process.wait()}")
            yield
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


def assembled(seed: int, recipe: str, folder: Path, cell: Path = CELL) -> WireRun:
    """One order over REST on the simulated devices of `cell`, to its end."""
    name, truth = f"wire-{seed}", folder / "truth"
    command = [sys.executable, "-m", "cellctl", "demo", "--once", "--json", "--speed", "1", "--port", "0"]
    command += ["--cell", str(cell), "--recipe", recipe, "--order", name, "--data", str(folder / "data")]
    with simulated(cell, recipe, seed, truth):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=WHOLE_RUN_S, check=False)
    told = json.loads(done.stdout.splitlines()[-1]) if done.stdout.strip() else {}
    wall_s = float(told.get("wall_time_s", nan))
    kept = truth / f"R-{name}-S-{name}.json"
    if not kept.exists():
        return WireRun(seed, "not begun", round(wall_s, 1), nan, nan, (nan, nan), None, (done.stderr[-600:],))
    true = json.loads(kept.read_text(encoding="utf-8"))
    records = sorted((folder / "data" / "runs").glob("*/record.zip"))
    wrong = tuple(_wrong(told, done.stderr, true, records, cell))
    same = None
    if not wrong:
        config = load_cell(cell).model_copy(update={"path": folder / cell.name})
        config = config.model_copy(update={"calibration": CalibrationEntry(file=load_cell(cell).calibration_path)})
        of = load_recipe(ROOT / "recipes" / f"{recipe}.toml")
        same = agreement(of, config, seed, (f"R-{name}", f"S-{name}"), summarise(read_record(records[0])[0]), true)
        wrong = tuple(same.wrong())
    return WireRun(
        seed=seed,
        verdict=str(told.get("verdict")),
        wall_s=round(wall_s, 1),
        worst_stud_n=max(true["peak_force_per_bolt_n"]),
        gap_mm=true["seating_gap_mm"],
        preload_n=(min(true["preload_n"]), max(true["preload_n"])),
        against_fake=same,
        wrong=wrong,
    )


def _wrong(told: dict[str, Any], errors: str, true: dict[str, Any], records: list[Path], cell: Path) -> Iterator[str]:
    if told.get("verdict") != "accepted":
        yield f"{told.get('state')}, {told.get('verdict')}: {told.get('reasons')} {errors[-400:]}"
    if not true["good"]:
        yield f"truth: {'; '.join(true['reasons'])}"
    if len(records) != 1:
        yield f"{len(records)} records"
        return
    if not (found := verify(records[0])).ok:
        yield f"record: {found.reasons}"
    header = value_of(read_record(records[0])[0], "run")
    if header is None or header["backends"] != dict(load_cell(cell).kinds):
        yield "the record does not say which backends were used"


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.journeys.two_processes", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--recipe", default="wire_bench")
    parser.add_argument("--figures", type=Path, help="folder that gets wire_RECIPE.json")
    args = parser.parse_args()
    runs = []
    for seed in range(args.first, args.first + args.seeds):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(assembled(seed, args.recipe, Path(folder)))
        print(json.dumps(asdict(runs[-1])), flush=True)
        if args.figures:
            entry = provenance(["python", "-m", "tests.journeys.two_processes", *sys.argv[1:]], ROOT)
            told = entry | {"recipe": args.recipe, "runs": [asdict(run) for run in runs]}
            (args.figures / f"wire_{args.recipe}.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
        if runs[-1].wrong:
            return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
