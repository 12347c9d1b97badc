"""From the last byte of a sample above the trip on the pty to the quick stop at the CAN hub, several ways in one run.

While it is measured the API answers 300 requests a second and vision works on a million points: in its worker beside
the bare loop and beside the guard's process, in the same process beside the guard in a thread; there once more with
Open3D's calls, which hold the interpreter, in the place of ours. Hub, pty and clock are in this process, before all
others in priority, so that what it adds is the same for all.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import sys
import tempfile
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from cellctl.studies.figures import provenance
from hal.bus.hub import CanHub
from hal.bus.pty import Pty
from hal.codec.cia301 import RPDO1, heartbeat
from hal.codec.cia402 import QUICK_STOP
from hal.codec.force_line import ForceLineError, IdentityTold, Request, Sample, StateTold, decode, encode, split
from hal.codec.lawicel import CanFrame
from hal.config import CellConfig, load_cell
from hal.errors import DeviceError
from hal.guard.heartbeat import Heartbeat
from hal.guard.link import GuardLink
from hal.interfaces import GuardLimits
from hal.priority import real_time
from tests.benchmarks.pipelines import ROOT, store
from tests.benchmarks.scenes import plain
from tests.dead.processes import cell_in

SAMPLES_PER_S = 1000.0
RATE = 300.0
POINTS = 1_000_000
TRIALS = 500
SEED = 1
REAL_TIME = 60
OVER_N = 9999.0
BEAT_SAMPLES = 500
SLOW = 5
"""So many times fewer trials beside Open3D, some of which take seconds."""
WAIT_S = 60.0
LATEST_S = 5.0
BETWEEN_S = (0.02, 0.06)
"""Of samples below the trip."""
PARTS = ("-m", "tests.benchmarks.reaction_parts")
FAKE_CELL = ROOT / "deploy" / "cell.fake.toml"
DELAYS = ROOT / "docs" / "figures" / "reaction_delays.json"
LIMITS = GuardLimits("reaction", tare_n=0.0, trip_n=100.0, low_n=-100.0, stale_ms=10_000.0, block=10)


class Amplifier:
    """Lines at their rate on a pty; `react` sends one sample above the trip and waits for the quick stop."""

    def __init__(self, path: Path, hub: CanHub) -> None:
        self._loop = asyncio.get_running_loop()
        self._pty = Pty(path, self._requests)
        self._pty.plug()
        self._rest = b""
        self._number = 0
        self._begun_s = self._loop.time()
        self._sent = 0.0
        self._stopped: asyncio.Future[float] | None = None
        self._bus, _ = hub.attach(self._frame)
        self._pump = asyncio.create_task(self._run())

    async def close(self) -> None:
        """Unplugged."""
        self._pump.cancel()
        await asyncio.wait({self._pump})
        self._pty.unplug()

    def _requests(self, data: bytes) -> None:
        lines, self._rest = split(self._rest + data)
        for line in lines:
            with contextlib.suppress(ForceLineError):
                match decode(line):
                    case Request(tag, "identify"):
                        told = IdentityTold(tag, "cellctl", "bench", "1", "1", SAMPLES_PER_S, 2000.0)
                        self._pty.write(encode(told))
                    case Request(tag, verb):
                        self._pty.write(encode(StateTold(tag, verb != "stop")))

    async def _run(self) -> None:
        while True:
            due = int((self._loop.time() - self._begun_s) * SAMPLES_PER_S)
            while self._number < due:
                self._say(float(self._number % 7))
                if self._number % BEAT_SAMPLES == 0:
                    self._bus(heartbeat(1))  # a bus on which nothing is heard is opened anew
            await asyncio.sleep(1.0 / SAMPLES_PER_S)

    def _say(self, force_n: float) -> None:
        self._pty.write(encode(Sample(self._number, force_n)))
        self._number += 1

    async def react(self) -> float:
        """Seconds from writing the sample to the quick stop; `LATEST_S` where there was none by then."""
        self._stopped = self._loop.create_future()
        self._sent = time.perf_counter()
        self._say(OVER_N)
        self._begun_s -= 1.0 / SAMPLES_PER_S  # one sample ahead of its time from here on
        try:
            async with asyncio.timeout(LATEST_S):
                return await self._stopped - self._sent
        except TimeoutError:
            return LATEST_S

    def _frame(self, frame: CanFrame) -> None:
        if frame.can_id == RPDO1 + 3 and frame.data[0] == QUICK_STOP and self._stopped and not self._stopped.done():
            self._stopped.set_result(time.perf_counter())


def reaction(work: Path) -> dict[str, Any]:
    """p50, p99 and the largest of each, and their ratios."""
    scene = plain(POINTS, SEED)
    store(scene, work)
    try:
        return asyncio.run(_measured(work, TRIALS))
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


async def _measured(work: Path, trials: int) -> dict[str, Any]:
    """All under the same load, which goes on from the first to the last."""
    seen = ("vision", str(work))
    async with _part("-m", "cellctl", "serve", "--cell", str(FAKE_CELL), "--port", "0", "--json", "--data",
                     str(work / "data")) as service:  # fmt: skip
        api = json.loads(await _line(service))
        async with _part(*PARTS, "load", api["url"], api["token"], str(RATE)) as asking:
            rates = asyncio.create_task(_rates(asking))
            async with _part(*PARTS, *seen) as beside:
                await _line(beside)
                real_time(REAL_TIME)
                bare = await _bare(work, trials)
                process = await _guarded(work, trials, lambda cell: ("-m", "hal.guard", "--cell", cell))
            thread = await _guarded(work, trials, lambda cell: (*PARTS, "thread", "ours", cell, str(work)))
            open3d = await _guarded(
                work, max(trials // SLOW, 1), lambda cell: (*PARTS, "thread", "open3d", cell, str(work))
            )
            rates.cancel()
            await asyncio.wait({rates})
            ways = {"floor": bare, "process": process, "thread": thread, "open3d": open3d}
            keep_delays(ways)
            found = {way: _told(seconds) for way, seconds in ways.items()}
    return found | {
        "points": POINTS,
        "asked_per_s": RATE,
        "answered_per_s": float(np.median(_RATES)),
        "process_to_floor": found["process"]["p99_ms"] / found["floor"]["p99_ms"],
        "thread_to_process": found["thread"]["p99_ms"] / found["process"]["p99_ms"],
        "open3d_to_process": found["open3d"]["p99_ms"] / found["process"]["p99_ms"],
    }


def keep_delays(ways: Mapping[str, list[float]], path: Path = DELAYS) -> None:
    """Every one of them, ascending, for those who draw from them (tests.dead.force_trips)."""
    ms = {way: {"ms": [round(1e3 * one, 4) for one in sorted(seconds)]} for way, seconds in ways.items()}
    entry = provenance(["python", "-m", "tests.benchmarks", "--only", "reaction"], ROOT)
    path.write_text(json.dumps(entry | ms, allow_nan=False) + "\n", encoding="utf-8")


async def _rates(asking: Process) -> None:
    _RATES.clear()
    while line := await _line(asking):
        _RATES.append(float(line))


_RATES: list[float] = []


def _told(seconds: list[float]) -> dict[str, float]:
    ms = 1e3 * np.array(seconds)
    return {"trials": len(ms), "p50_ms": float(np.median(ms)), "p99_ms": float(np.percentile(ms, 99)),
            "max_ms": float(ms.max())}  # fmt: skip


async def _bare(work: Path, trials: int) -> list[float]:
    """The floor: from pty to socket, nothing else."""
    draw = Random(SEED)
    async with _stand(work) as (amplifier, hub, path), _part(*PARTS, "floor", str(path), str(hub.port)) as loop:
        await _line(loop)
        seconds = []
        for _ in range(trials):
            await asyncio.sleep(draw.uniform(*BETWEEN_S))
            seconds.append(await amplifier.react())
        return seconds


async def _guarded(work: Path, trials: int, command: Callable[[str], tuple[str, ...]]) -> list[float]:
    """Through the guard that `command` starts for a cell file; this process is its controller."""
    draw, folder = Random(SEED), Path(tempfile.mkdtemp(prefix="reaction-", dir="/tmp"))
    async with _stand(folder) as (amplifier, hub, _):
        cell = _patient(cell_in(folder, {4401: hub.port}))
        async with _part(*command(str(cell.path))):
            link = GuardLink(cell.beside(cell.guard.socket), silence_s=WAIT_S)
            beats = Heartbeat(link.beat, lambda: True, 0.02)
            beats.start()
            await link.reached(bus=True, within_s=60.0)
            await link.call("connect")
            seconds = []
            for _ in range(trials):
                await _armed(link)
                await asyncio.sleep(draw.uniform(*BETWEEN_S))
                seconds.append(await amplifier.react())
            await link.release()
            await beats.close()
    shutil.rmtree(folder)
    return seconds


def _patient(cell: CellConfig) -> CellConfig:
    """The same cell, whose guard trips on force alone, however long it is kept waiting."""
    text = cell.path.read_text(encoding="utf-8").replace("heartbeat_s = 0.1 ", "heartbeat_s = 10.0 ")
    text = text.replace("heartbeat_s = 0.1\n", "heartbeat_s = 10.0\n")
    text = text.replace("stale_ms = 150.0", "beat_ms = 10000.0\nquiet_ms = 10000.0\nstale_ms = 10000.0")
    cell.path.write_text(text, encoding="utf-8")
    return load_cell(cell.path)


async def _armed(link: GuardLink) -> None:
    """Cleared, and watching. A guard that was kept waiting so long that it tripped by itself is cleared again."""
    async with asyncio.timeout(WAIT_S):
        while True:
            with contextlib.suppress(DeviceError):
                assert link.told is not None
                await link.call("clear", epoch=link.told.epoch)
                await link.call("arm", **asdict(LIMITS))
                if link.told.armed:
                    return
            await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def _stand(folder: Path) -> AsyncIterator[tuple[Amplifier, CanHub, Path]]:
    hub = CanHub()
    await hub.start()
    amplifier = Amplifier(folder / "jack_force", hub)
    try:
        yield amplifier, hub, folder / "jack_force"
    finally:
        await amplifier.close()
        await hub.close()


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
