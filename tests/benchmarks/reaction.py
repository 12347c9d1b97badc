"""From the last byte of a sample above the trip on the pty to the quick stop at the CAN hub, several ways in one run.

While it is measured the API is asked 300 times a second and vision works on a million points. The floor and the guard
in its process are measured in turns, beside the service and its vision worker, which are processes of their own as in
production. In the other ways the guard is a thread: beside our vision, beside Open3D's calls, which hold the
interpreter, or beside both our vision and the service itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from cellctl.studies.figures import provenance
from hal.priority import never_paused, real_time
from tests.benchmarks.pipelines import ROOT, store
from tests.benchmarks.reaction_stand import Stand, standing
from tests.benchmarks.scenes import plain

RATE = 300.0
POINTS = 1_000_000
TRIALS = 500
ROUNDS = 2
"""Floor and guard's process take turns so often, so that both see the same of what else the machine does."""
SLOW = 10
"""So many times fewer trials beside Open3D, some of which take seconds."""
SEED = 1
REAL_TIME = 60
COMMAND = 'make bench ARGS="--only reaction"'
PARTS = ("-m", "tests.benchmarks.reaction_parts")
SERVE = ("serve", "--cell", str(ROOT / "deploy" / "cell.fake.toml"), "--port", "0", "--json")
Way = Callable[[Stand], AbstractAsyncContextManager[None]]


@dataclass(slots=True)
class Delays:
    """Of one way: seconds of each trial; how many requests a second were answered meanwhile, each second."""

    seconds: list[float] = field(default_factory=list)
    reading: list[float] = field(default_factory=list)
    """Of these until the bytes were read, in the bare loop: what the kernel takes to hand them on."""
    answered: list[float] = field(default_factory=list)

    def told(self) -> dict[str, float]:
        """In milliseconds."""
        ms = 1e3 * np.array(self.seconds)
        return {
            "trials": len(ms),
            "p50_ms": float(np.median(ms)),
            "p99_ms": float(np.percentile(ms, 99)),
            "max_ms": float(ms.max()),
            "answered_per_s": float(np.median(self.answered)),
        }


def reaction(work: Path, delays: Path) -> dict[str, Any]:
    """p50, p99 and the largest of each way, and ratios of p99; every single delay goes to file `delays`."""
    store(plain(POINTS, SEED), work)
    load = os.getloadavg()[0]
    never_paused()
    try:
        measured = asyncio.run(_measured(work, TRIALS))
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        gc.enable()
    keep(measured, delays)
    reading_ms = 1e3 * float(np.percentile(measured["floor"].reading, 99))
    about = {"points": POINTS, "asked_per_s": RATE, "load_average_before": load, "floor_reading_p99_ms": reading_ms}
    return about | compared({name: one.told() for name, one in measured.items()})


def keep(measured: Mapping[str, Delays], path: Path) -> None:
    """Every delay in milliseconds, ascending, by way, for those who draw from them (tests.dead.force_trips)."""
    ms = {name: {"ms": [round(1e3 * one, 4) for one in sorted(way.seconds)]} for name, way in measured.items()}
    entry = provenance([COMMAND], ROOT)
    path.write_text(json.dumps(entry | ms, allow_nan=False) + "\n", encoding="utf-8")


def compared(ways: dict[str, dict[str, float]]) -> dict[str, Any]:
    """The ways, with p99 of the guard's process over that of the floor, and p99 of each thread over the process's."""
    p99 = {name: way["p99_ms"] for name, way in ways.items()}
    return ways | {
        "process_to_floor": p99["process"] / p99["floor"],
        "thread_to_process": p99["thread"] / p99["process"],
        "together_to_process": p99["together"] / p99["process"],
        "open3d_to_process": p99["open3d"] / p99["process"],
    }


async def _measured(work: Path, trials: int) -> dict[str, Delays]:
    """All under the same load, which goes on from the first to the last but for the way that is asked itself."""
    ways = {name: Delays() for name in ("floor", "process", "thread", "together", "open3d")}
    answered: list[float] = []
    real_time(REAL_TIME)

    async def measure(name: str, way: Way, share: int) -> None:
        draw, begun = Random(SEED + len(ways[name].seconds)), len(answered)
        async with standing() as stand:
            async with way(stand):
                ways[name].seconds += await (stand.bare if name == "floor" else stand.guarded)(trials // share, draw)
            ways[name].reading += stand.reading
        ways[name].answered += answered[begun:]

    async with _service(answered, "-m", "cellctl", *SERVE, "--data", str(work / "data")):
        async with _part(*PARTS, "vision", str(work)) as beside:
            await _line(beside)
            for _ in range(ROUNDS):
                await measure("floor", _floor, ROUNDS)
                await measure("process", _process, ROUNDS)
        await measure("thread", lambda stand: _thread("ours", stand, work), 1)
        await measure("open3d", lambda stand: _thread("open3d", stand, work), SLOW)
    await measure("together", lambda stand: _together(answered, stand, work), 1)
    return ways


# ------------------------------------------------------------ what reacts


@contextlib.asynccontextmanager
async def _floor(stand: Stand) -> AsyncIterator[None]:
    pty = stand.cell.beside(stand.cell.devices.jack_force.path)
    async with _part(*PARTS, "floor", str(pty), str(stand.port)) as loop:
        await _line(loop)
        yield
        stand.reading = [float(await _line(loop)) - sent_s for sent_s in stand.sent]


@contextlib.asynccontextmanager
async def _process(stand: Stand) -> AsyncIterator[None]:
    async with _part("-m", "hal.guard", "--cell", str(stand.cell.path)):
        yield


@contextlib.asynccontextmanager
async def _thread(kind: str, stand: Stand, work: Path) -> AsyncIterator[None]:
    async with _part(*PARTS, "thread", kind, str(stand.cell.path), str(work)):
        yield


@contextlib.asynccontextmanager
async def _together(answered: list[float], stand: Stand, work: Path) -> AsyncIterator[None]:
    command = (*PARTS, "together", str(stand.cell.path), str(work), *SERVE, "--data", str(work / "together"))
    async with _service(answered, *command):
        yield


# ------------------------------------------------------------ processes


@contextlib.asynccontextmanager
async def _service(answered: list[float], *command: str) -> AsyncIterator[None]:
    """Serving, and asked at the rate since a second; what it answers each further one is appended."""
    async with _part(*command) as service:
        api = json.loads(await _line(service))
        async with _part(*PARTS, "load", api["url"], api["token"], str(RATE)) as asking:
            await _line(asking)
            counting = asyncio.create_task(_count(asking, answered))
            try:
                yield
            finally:
                counting.cancel()
                await asyncio.wait({counting})


async def _count(asking: Process, answered: list[float]) -> None:
    while line := await _line(asking):
        answered.append(float(line))


@contextlib.asynccontextmanager
async def _part(*command: str) -> AsyncIterator[Process]:
    process = await asyncio.create_subprocess_exec(sys.executable, *command, cwd=ROOT, stdout=PIPE)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def _line(process: Process) -> bytes:
    assert process.stdout is not None
    return await process.stdout.readline()
