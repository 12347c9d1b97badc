"""Force sensors on the wire: a simulated amplifier on a pseudo-terminal, pyserial, the real backend."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

from hal.entries import ForceLineEntry
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.force import ForceAmplifier
from hal.real.force import SerialForceSensor
from tests.contract.fakes import fake_device


@contextlib.asynccontextmanager
async def wired(
    name: str, plant: Plant, faults: FaultBook, **numbers: float
) -> AsyncIterator[tuple[ForceAmplifier, SerialForceSensor]]:
    """An amplifier that is plugged in, and the backend, not connected; `numbers` are those of its entry."""
    behind = fake_device(name, plant, BehindWire(faults))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        amplifier = ForceAmplifier(behind, faults, path)
        entry = ForceLineEntry(kind="force_line", path=str(path), rate_hz=behind.rate_hz, range_n=behind.range_n)
        sensor = SerialForceSensor(name, entry.model_copy(update=numbers))
        await amplifier.start()
        try:
            yield amplifier, sensor
        finally:
            await sensor.close()
            await amplifier.close()


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[SerialForceSensor]:
    """See `tests.contract.backends.Installed`."""
    async with wired(name, plant, faults) as (_, sensor):
        yield sensor
