"""What the reaction is measured with: an amplifier on a pty, a CAN hub, and a controller that arms a guard.

All of it is in one process, with one clock, before all others in priority: what it adds is the same for every way.
"""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import asdict
from pathlib import Path
from random import Random

from hal.bus.hub import CanHub
from hal.bus.pty import Pty
from hal.codec.cia301 import RPDO1, heartbeat
from hal.codec.cia402 import QUICK_STOP
from hal.codec.force_line import ForceLineError, IdentityTold, Request, Sample, StateTold, decode, encode, split
from hal.codec.lawicel import CanFrame
from hal.config import CellConfig, load_cell
from hal.errors import DeviceError, NotConnected
from hal.guard.heartbeat import Heartbeat
from hal.guard.link import GuardLink
from hal.interfaces import GuardLimits
from tests.dead.processes import cell_in

SAMPLES_PER_S = 1000.0
OVER_N = 9999.0
BEAT_SAMPLES = 500
WAIT_S = 60.0
LATEST_S = 5.0
BETWEEN_S = (0.02, 0.06)
"""Of samples below the trip."""
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
        self.sent: list[float] = []
        """When, by `time.perf_counter`, each sample above the trip was written."""
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
        self.sent.append(time.perf_counter())
        self._say(OVER_N)
        self._begun_s -= 1.0 / SAMPLES_PER_S  # one sample ahead of its time from here on
        try:
            async with asyncio.timeout(LATEST_S):
                return await self._stopped - self.sent[-1]
        except TimeoutError:
            return LATEST_S

    def _frame(self, frame: CanFrame) -> None:
        if frame.can_id == RPDO1 + 3 and frame.data[0] == QUICK_STOP and self._stopped and not self._stopped.done():
            self._stopped.set_result(time.perf_counter())


class Stand:
    """Amplifier and hub, and `cell`, the file of a cell that has both."""

    def __init__(self, amplifier: Amplifier, hub: CanHub, cell: CellConfig) -> None:
        self._amplifier = amplifier
        self.port = hub.port
        self.cell = cell
        self.sent = amplifier.sent
        self.reading: list[float] = []
        """Seconds until the bare loop had read each of them."""

    async def bare(self, trials: int, draw: Random) -> list[float]:
        """Seconds of each reaction of whoever reads the pty and writes to the hub."""
        seconds = []
        for _ in range(trials):
            await asyncio.sleep(draw.uniform(*BETWEEN_S))
            seconds.append(await self._amplifier.react())
        return seconds

    async def guarded(self, trials: int, draw: Random) -> list[float]:
        """The same of the cell's guard, armed anew before each; this process is its controller."""
        link = GuardLink(self.cell.beside(self.cell.guard.socket), silence_s=WAIT_S)
        beats = Heartbeat(link.beat, lambda: True, 0.02)
        beats.start()
        await link.reached(bus=True, within_s=WAIT_S)
        await _patiently(lambda: link.call("connect", device="jack_force"))
        seconds = []
        for _ in range(trials):
            await _armed(link)
            seconds += await self.bare(1, draw)
        await link.release()
        await beats.close()
        return seconds


@contextlib.asynccontextmanager
async def standing() -> AsyncIterator[Stand]:
    """A stand in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="reaction-", dir="/tmp") as name:
        hub = CanHub()
        await hub.start()
        cell = _patient(cell_in(Path(name), {4401: hub.port}))
        amplifier = Amplifier(cell.beside(cell.devices.jack_force.path), hub)
        try:
            yield Stand(amplifier, hub, cell)
        finally:
            await amplifier.close()
            await hub.close()


def _patient(cell: CellConfig) -> CellConfig:
    """The same cell, whose guard trips on force alone, however long it is kept waiting."""
    text = cell.path.read_text(encoding="utf-8").replace("heartbeat_s = 0.1 ", "heartbeat_s = 10.0 ")
    text = text.replace("heartbeat_s = 0.1\n", "heartbeat_s = 10.0\n")
    text = text.replace("stale_ms = 150.0", "beat_ms = 10000.0\nquiet_ms = 10000.0\nstale_ms = 10000.0")
    cell.path.write_text(text, encoding="utf-8")
    return load_cell(cell.path)


async def _armed(link: GuardLink) -> None:
    """Cleared, and watching. A guard that was kept waiting so long that it tripped by itself is cleared again."""

    async def arm() -> None:
        assert link.told is not None
        await link.call("clear", epoch=link.told.epoch)
        await link.call("arm", **asdict(LIMITS))
        if not link.told.armed:
            raise NotConnected("tripped again")

    await _patiently(arm)


async def _patiently(do: Callable[[], Awaitable[object]]) -> None:
    """Until it is done: beside what holds the interpreter a guard may take seconds to answer."""
    async with asyncio.timeout(WAIT_S):
        while True:
            with contextlib.suppress(DeviceError):
                await do()
                return
            await asyncio.sleep(0.01)
