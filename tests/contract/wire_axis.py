"""An axis on the wire: CAN hub, simulated drive with the plant behind it, python-can's slcan, the real backend."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from hal.bus.can import CanBus
from hal.bus.hub import CanHub
from hal.entries import AXIS_UNITS, AxisEntry, CanAxisEntry
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.can_node import CanNode
from hal.real.axes import CanAxis
from tests.contract.fakes import CELL

FEED = 100_000
"""Drive units per revolution of the motor: 10 mm at a ten-thousandth of one."""
BEAT_S = 0.05


def entry_of(name: str, number: int) -> CanAxisEntry:
    """The entry of an axis of the example cell, on CAN."""
    fake = getattr(CELL.devices, name)
    assert isinstance(fake, AxisEntry)
    return CanAxisEntry(
        **fake.model_dump(exclude={"kind"}),
        kind="canopen",
        node=number,
        encoder_increments=10_000,
        feed=FEED,
        homing_method=19,
        pdo_s=0.05,
    )


@dataclass
class Wire:
    """One axis and everything around it."""

    hub: CanHub
    bus: CanBus
    node: CanNode
    axis: CanAxis
    beats: asyncio.Task[None]


def bus_of(hub: CanHub) -> CanBus:
    """The controller's adapter."""
    return CanBus(
        {
            "interface": "slcan",
            "channel": f"socket://127.0.0.1:{hub.port}",
            "bitrate": 1_000_000,
            "sleep_after_open": 0.0,
        }
    )


async def beat(bus: CanBus) -> None:
    """The controller's own cycle."""
    while True:
        bus.beat()
        await asyncio.sleep(BEAT_S)


@contextlib.asynccontextmanager
async def wired(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[Wire]:
    """Everything between a plant and the backend of one of its axes, not connected."""
    hub = CanHub()
    await hub.start()
    number = 1 + list(AXIS_UNITS).index(name)
    entry = entry_of(name, number)
    node = CanNode(hub, number, name, plant, faults, scale=entry.counts_per_unit, feed=FEED)
    bus = bus_of(hub)
    axis = CanAxis(name, AXIS_UNITS[name], entry, bus)
    wire = Wire(hub, bus, node, axis, asyncio.create_task(beat(bus), name="beats"))
    try:
        yield wire
    finally:
        await axis.close()
        wire.beats.cancel()
        await asyncio.wait({wire.beats})
        node.close()
        await hub.close()


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[CanAxis]:
    """See `tests.contract.backends.Installed`."""
    async with wired(name, plant, faults) as wire:
        yield wire.axis
