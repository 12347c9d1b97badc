"""Devices behind the guard: hub, drive and amplifier simulated, the guard's own process object in the same loop, its
socket and its ring between it and the backend."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hal.bus.can import CanBus
from hal.bus.hub import CanHub
from hal.config import CellConfig, load_cell
from hal.entries import AXIS_UNITS, ForceLineEntry
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.can_node import CanNode
from hal.fake.wire.force import ForceAmplifier
from hal.guard.force import RingForceSensor
from hal.guard.heartbeat import Heartbeat
from hal.guard.link import GuardLink
from hal.guard.process import GuardProcess
from hal.interfaces import Identity
from hal.real.axes import CanAxis
from tests.contract.fakes import fake_device
from tests.contract.wire_axis import FEED, entry_of

CELL = load_cell(Path(__file__).parents[2] / "deploy" / "cell.wire.toml")


def config_of(folder: Path, hub: CanHub, **entries: Any) -> CellConfig:
    """The wire cell with a guard of its own in `folder`, on `hub`, with other `entries`."""
    assert CELL.can is not None
    return CELL.model_copy(
        update={
            "path": folder / "cell.toml",
            "can": CELL.can.model_copy(update={"channel": f"socket://127.0.0.1:{hub.port}"}),
            "guard": CELL.guard.model_copy(update={"process": "service", "socket": Path("g")}),
            "devices": CELL.devices.model_copy(update=entries),
        }
    )


@dataclass
class Guarded:
    """A guard that runs, and a link to it that is not open."""

    process: GuardProcess
    link: GuardLink
    config: CellConfig
    hub: CanHub
    beats: Heartbeat


@contextlib.asynccontextmanager
async def guarded(folder: Path, **entries: Any) -> AsyncIterator[Guarded]:
    """Hub, guard, and the beats of a controller."""
    hub = CanHub()
    await hub.start()
    config = config_of(folder, hub, **entries)
    assert config.can is not None
    process = GuardProcess(config, CanBus(config.can.described, node=config.can.node))
    link = GuardLink(folder / "g")
    beats = Heartbeat(link.beat, lambda: True, 0.02)
    await process.start()
    beats.start()
    guard = Guarded(process, link, config, hub, beats)
    try:
        yield guard
    finally:
        await guard.beats.close()
        await guard.process.close()
        await hub.close()


async def cleared(link: GuardLink) -> None:
    """Open the gate for `link`, which is open."""
    assert link.told is not None
    epoch = link.told.epoch
    link.beat()
    await link.call("clear", epoch=epoch)
    link.epoch = epoch


class _Cleared(CanAxis):
    """An axis on which the gate is opened once it is connected, as the cell does when it re-arms."""

    async def connect(self) -> Identity:
        identity = await super().connect()
        assert isinstance(self.link, GuardLink)
        await cleared(self.link)
        return identity


@contextlib.asynccontextmanager
async def installed_axis(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[CanAxis]:
    """See `tests.contract.backends.Installed`."""
    number = 1 + list(AXIS_UNITS).index(name)
    entry = entry_of(name, number)
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        async with guarded(Path(folder), **{name: entry}) as guard:
            node = CanNode(guard.hub, number, name, plant, faults, scale=entry.counts_per_unit, feed=FEED)
            axis = _Cleared(name, AXIS_UNITS[name], entry, guard.link)
            try:
                yield axis
            finally:
                await axis.close()
                node.close()


@contextlib.asynccontextmanager
async def installed_force(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[RingForceSensor]:
    """Any of the force sensors in the place of the jack's."""
    behind = fake_device(name, plant, BehindWire(faults))
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        path = Path(folder) / name
        amplifier = ForceAmplifier(behind, faults, path)
        entry = ForceLineEntry(kind="force_line", path=str(path), rate_hz=behind.rate_hz, range_n=behind.range_n)
        async with guarded(Path(folder), jack_force=entry) as guard:
            sensor = RingForceSensor(name, entry, guard.link, Path(folder) / "g")
            await amplifier.start()
            try:
                yield sensor
            finally:
                await sensor.close()
                await amplifier.close()
