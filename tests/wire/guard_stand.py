"""One jack with its force sensor behind a guard: simulators, guard and controller's side in one loop."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from hal.bus.can import CanBus
from hal.codec.lawicel import CanFrame
from hal.entries import ForceLineEntry
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.can_node import CanNode
from hal.fake.wire.force import ForceAmplifier
from hal.guard.client import GuardClient
from hal.guard.force import RingForceSensor
from hal.guard.heartbeat import Heartbeat
from hal.guard.process import GuardProcess
from hal.interfaces import GuardLimits
from hal.latch import Latch
from hal.real.axes import CanAxis
from tests.contract.backends import plant_of, quickened
from tests.contract.fakes import fake_device
from tests.contract.wire_axis import FEED, entry_of
from tests.contract.wire_guard import Guarded, guarded

NUMBER = 3
WEIGHT_N = 980.665
SPEED = 5.0
LIMITS = GuardLimits("insert", tare_n=WEIGHT_N, trip_n=200.0, low_n=-200.0, stale_ms=400.0, block=10)


@dataclass
class GuardStand:
    """Everything, connected and re-armed."""

    guard: Guarded
    plant: Plant
    node: CanNode
    amplifier: ForceAmplifier
    axis: CanAxis
    sensor: RingForceSensor
    client: GuardClient
    latch: Latch
    beats: Heartbeat
    frames: list[CanFrame]

    async def restart_guard(self) -> None:
        """Another guard in the place of the one that was closed."""
        can = self.guard.config.can
        assert can is not None
        self.guard.process = GuardProcess(self.guard.config, CanBus(can.described, node=can.node))
        await self.guard.process.start()

    async def rearm(self) -> None:
        """As the cell does."""
        await self.client.disarm()
        await self.client.rearm()
        await self.axis.rearm()


@contextlib.asynccontextmanager
async def standing() -> AsyncIterator[GuardStand]:
    """Take it all up and down."""
    plant, faults = plant_of("ideal"), FaultBook()
    entry = entry_of("jack", NUMBER)
    behind = fake_device("jack_force", plant, BehindWire(faults))
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        line = ForceLineEntry(kind="force_line", path=str(Path(folder) / "force"), rate_hz=behind.rate_hz)
        amplifier = ForceAmplifier(behind, faults, Path(line.path))
        async with guarded(Path(folder), jack=entry, jack_force=line) as guard:
            node = CanNode(guard.hub, NUMBER, "jack", plant, faults, scale=entry.counts_per_unit, feed=FEED)
            await amplifier.start()
            axis = CanAxis("jack", "mm", entry, guard.link)
            sensor = RingForceSensor("jack_force", line, guard.link, Path(folder) / "g")
            latch = Latch()
            client = GuardClient(guard.link, sensor, (axis,), latch, halt_deadline_s=1.0)
            frames: list[CanFrame] = []
            guard.hub.log = frames
            stand = GuardStand(guard, plant, node, amplifier, axis, sensor, client, latch, guard.beats, frames)
            try:
                await client.open()
                await sensor.connect()
                await axis.connect()
                await stand.rearm()
                await axis.home()
                yield stand
            finally:
                await client.close()
                await sensor.close()
                await axis.close()
                await amplifier.close()
                node.close()


def on_stand(case: Callable[[GuardStand], Awaitable[None]]) -> None:
    """Run `case`; no task may be left."""

    async def main() -> None:
        async with standing() as stand:
            await case(stand)

    quickened(main(), SPEED)
