"""Modbus devices: the real backend over TCP, or RTU on a pseudo-terminal, to the simulator on the plant."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import Any

from hal.bus.modbus import Lines
from hal.entries import Devices
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus import SimulatedModbus
from hal.real.modbus_devices import modbus_device
from tests.contract.fakes import fake_device

UNIT = 17


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[Any]:
    """Modbus TCP."""
    simulated = SimulatedModbus({UNIT: {0: fake_device(name, plant, faults)}}, plant, faults)
    port = await simulated.start()
    try:
        yield device(name, port=port)
    finally:
        await simulated.close()


@contextlib.asynccontextmanager
async def installed_rtu(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[Any]:
    """Modbus RTU on a pseudo-terminal."""
    simulated = SimulatedModbus({UNIT: {0: fake_device(name, plant, faults)}}, plant, faults, "rtu")
    path = await simulated.start_pty()
    try:
        yield device(name, port_path=path, parity="N")
    finally:
        await simulated.close()


def device(name: str, lines: Lines | None = None, **numbers: Any) -> Any:
    """The real device of this name at unit `UNIT`, with numbers of its entry in the cell file."""
    field = Devices.model_fields[name]
    entry = next(kind for kind in field.annotation.__args__ if "Modbus" in kind.__name__)  # type: ignore[union-attr]
    return modbus_device(name, entry(**{"kind": "modbus", "unit": UNIT} | numbers), lines or Lines())
