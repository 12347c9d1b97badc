"""The service killed in mid-tightening and started again, as real processes: `python -m tests.journeys.killed_service`.

    --seed N    the twin's, and what decides which program is under way; default 1

The simulators and the plant behind them live in this process and go on meanwhile, so that what guns really did is seen
and not asked for. The cell must be up and at rest within 5 s of the kill and say what is true of the run that was cut
off; an operator then clears it, and the next parts are assembled on it. No nut is tightened twice.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import signal
import sys
import tempfile
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from random import Random

from cellctl.api.schemas import JobOrderRequest
from cellctl.client import CellClient
from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from cellctl.records.summary import value_of
from cellctl.twin import RENDERING, truth_limits, twin_of
from hal.config import CellConfig, load_cell
from hal.fake.devices.guns import joints_of
from hal.fake.plant import Plant
from hal.fake.truth import truth_of
from hal.fake.wire.stand import standing
from hal.jobs import ProcessJobs
from hal.priority import real_time
from tests.dead.processes import CELL, REAL_TIME, cell_in
from tests.journeys.twin_runs import ROOT
from tests.journeys.wire_judge import Begun, Ended, told_by, witness, wrong

RECIPE = ROOT / "recipes" / "wire_bench.toml"
STARTS = 8
"""It is killed while gun a runs one of its first so many programs."""
PATIENT = {
    'process = "service"': 'process = "child"',
    "heartbeat_s = 0.1 ": "heartbeat_s = 1.0 ",
    "heartbeat_s = 0.1\n": "heartbeat_s = 1.0\n",
    "stale_ms = 150.0": "beat_ms = 1000.0\nquiet_ms = 3000.0\nstale_ms = 600.0",
    "read_s = 1.0": "read_s = 2.0",
}
UP_S = 5.0
START_S = 60.0
RUN_S = 600.0
LOOK_S = 0.01


@dataclass(slots=True)
class Killed:
    """What came of it. `up_s`: seconds from the kill until the API answered that the cell is at rest."""

    seed: int
    program: str = ""
    up_s: float = 0.0
    state: str = ""
    why: str = ""
    verdict: str = ""
    begun: int = 0
    wrong: list[str] = field(default_factory=list)


def killed(seed: int) -> Killed:
    """One service, killed once."""
    with tempfile.TemporaryDirectory(prefix="killed-", dir="/tmp") as folder:
        return asyncio.run(_killed(seed, _cell(Path(folder)), Path(folder)))


def _cell(folder: Path) -> CellConfig:
    """The wire cell at free ports, its guard a child of the service, patient with a busy desk: how soon devices come to
    rest when nobody leads them any more is measured elsewhere."""
    path = cell_in(folder).path
    text = path.read_text(encoding="utf-8")
    for before, after in PATIENT.items():
        assert before in text, f"{CELL} has no {before}"
        text = text.replace(before, after)
    path.write_text(text, encoding="utf-8")
    return load_cell(path)


async def _killed(seed: int, config: CellConfig, folder: Path) -> Killed:
    recipe, told, draw = load_recipe(RECIPE), Killed(seed), Random(seed)
    async with ProcessJobs(modules=RENDERING) as jobs:
        twin = twin_of(recipe, config, jobs, seed=seed, now=asyncio.get_running_loop().time())
        begun = witness(joints_of(twin.plant))
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)):
            real_time(REAL_TIME)
            run_id = await _until_killed(config, folder, twin.plant, draw, told, begun)
            died_s = time.monotonic()
            async with _service(config, folder) as (_, cell):
                await _at_rest(cell, run_id, died_s, told)
                cut = _ended(folder, run_id, begun, (told.state, ""))
                await _cleared(cell)
                after = await _assembled(cell, told)
                truth = truth_of(twin.plant, truth_limits(recipe))
    whole = _ended(folder, after, begun, ("Complete", told.verdict), truth.reasons)
    told.begun = len(begun)
    told.wrong += [f"cut off: {text}" for text in [*wrong(cut, ("the service ended",)), *_not_told(cut, begun)]]
    told.wrong += [f"next parts: {text}" for text in wrong(whole, (), goes_on=True)]
    return told


@contextlib.asynccontextmanager
async def _service(config: CellConfig, folder: Path) -> AsyncIterator[tuple[Process, CellClient]]:
    """`cellctl serve` on the data of `folder`, and a client of it; killed at the end."""
    command = [sys.executable, "-m", "cellctl", "serve", "--cell", str(config.path), "--port", "0", "--json"]
    command += ["--data", str(folder / "data")]
    with (folder / "said").open("ab") as said:
        process = await asyncio.create_subprocess_exec(*command, stdout=PIPE, stderr=said, cwd=ROOT)
    assert process.stdout is not None
    try:
        async with asyncio.timeout(START_S):
            line = await process.stdout.readline()
        if not line:
            raise RuntimeError((folder / "said").read_text(encoding="utf-8")[-600:])
        at = json.loads(line)
        async with CellClient(at["url"], at["token"]) as client:
            yield process, client
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


def _order(number: int) -> JobOrderRequest:
    serials = {"rotor": f"R-{number}", "shaft": f"S-{number}"}
    wanted = {"job_order_id": f"JO-{number}", "recipe": "wire_bench", "recipe_version": 1, "serials": serials}
    return JobOrderRequest.model_validate(wanted)


async def _until_killed(
    config: CellConfig, folder: Path, plant: Plant, draw: Random, told: Killed, begun: list[Begun]
) -> str:
    """An order, killed in mid-tightening; its run."""
    gun, wanted = joints_of(plant).guns["a"], draw.randint(1, STARTS)
    async with _service(config, folder) as (process, cell):
        async with asyncio.timeout(START_S):
            now = await cell.until("Idle", "Stopped", "Aborted")
        if now.state != "Idle":
            raise RuntimeError(f"{now.state}: {now.why}")
        run_id = (await cell.post_job_order(_order(1))).run_id
        async with asyncio.timeout(RUN_S):
            while sum(one.gun == "gun_a" for one in begun) < wanted or gun.active is None:
                if (now := await _state_of(process, cell, begun)) is not None:
                    raise RuntimeError(f"the first run ended by itself: {now}")
                await asyncio.sleep(LOOK_S)
        left_s = max(gun.active.end_s - asyncio.get_running_loop().time(), 0.0)
        await asyncio.sleep(draw.uniform(0.0, 0.9 * left_s))
        process.send_signal(signal.SIGKILL)
        told.program = f"{begun[-1].stage}, program {wanted} of gun a"
    return run_id


async def _state_of(process: Process, cell: CellClient, begun: list[Begun]) -> str | None:
    """Why nothing more is to be waited for, or None; the service is asked before the first program only."""
    if process.returncode is not None:
        return f"exit {process.returncode}"
    if not begun:
        await asyncio.sleep(0.5)
        now = await cell.cell()
        return f"{now.state}: {now.why}" if now.state in ("Held", "Stopped", "Aborted", "Complete") else None
    return None


async def _at_rest(cell: CellClient, run_id: str, died_s: float, told: Killed) -> None:
    """The new service answers: at rest, in time, with what is true."""
    async with asyncio.timeout(START_S):
        now = await cell.until("Held", "Aborted")
    told.up_s = round(time.monotonic() - died_s, 2)
    told.state, told.why = now.state, now.why
    if told.up_s > UP_S:
        told.wrong.append(f"at rest {told.up_s:.1f} s after the kill (limit {UP_S:g} s)")
    if run_id not in now.why:
        told.wrong.append(f"the cell does not say which run was cut off: {now.why}")


async def _cleared(cell: CellClient) -> None:
    """What an operator does."""
    async with asyncio.timeout(START_S):
        await cell.command("clear")
        await cell.until("Stopped")
        await cell.command("reset")
        await cell.until("Idle")


async def _assembled(cell: CellClient, told: Killed) -> str:
    """The next order, to its end; its run."""
    run_id = (await cell.post_job_order(_order(2))).run_id
    async with asyncio.timeout(RUN_S):
        now = await cell.until("Complete", "Held", "Stopped", "Aborted")
        told.verdict = str((await cell.run(run_id)).verdict)
    if now.state != "Complete":
        told.wrong.append(f"next parts: {now.state}: {now.why}")
    return run_id


def _ended(
    folder: Path, run_id: str, begun: list[Begun], came_to: tuple[str, str], untrue: tuple[str, ...] = ()
) -> Ended:
    """One of the two runs, as its record and the plant tell it."""
    record = folder / "data" / "runs" / run_id / "record.zip"
    rows, faults = told_by(record) if record.exists() else ((), (f"no record of {run_id}",))
    end = value_of(rows, "ended") or {}
    intents = {row.value.get("key") for row in rows if row.kind == "intent"}
    mine = tuple(one for one in begun if one.key in intents)
    state, verdict = came_to[0], came_to[1] or str(end.get("verdict"))
    return Ended(state, verdict, tuple(end.get("reasons", ())), untrue, mine, rows, faults, "Idle")


def _not_told(cut: Ended, begun: list[Begun]) -> list[str]:
    """Every program of the cut-off run is either settled in its record or named as unknown."""
    closed = {str(row.value["key"]) for row in cut.rows if row.kind in ("result", "error", "cancelled")}
    fetched = {str(row.value["result"]["key"]) for row in cut.rows if row.kind == "result" and _is_kept(row.value)}
    said = "; ".join(cut.reasons)
    lost = [one for one in cut.begun if one.key not in closed | fetched and f"{one.gun} tighten" not in said]
    strange = [one for one in begun if one.parts == 1 and one not in cut.begun]
    return [f"nothing is said of {one}" for one in lost] + [f"not in the record: {one}" for one in strange]


def _is_kept(value: dict[str, object]) -> bool:
    return value.get("command") == "result" and isinstance(value.get("result"), dict)


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.journeys.killed_service", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    done = killed(parser.parse_args().seed)
    print(json.dumps(asdict(done)), flush=True)
    return 3 if done.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
