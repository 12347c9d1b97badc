"""The scanner behind GenTL: a simulated camera on a TCP connection, the real backend's process asks there."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import get_args

from hal.entries import GentlEntry
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.gentl import SimulatedCamera
from hal.interfaces import View
from hal.real.gentl import GentlScanner
from tests.contract.fakes import fake_device


@contextlib.asynccontextmanager
async def wired(
    name: str, plant: Plant, faults: FaultBook, **changes: object
) -> AsyncIterator[tuple[SimulatedCamera, GentlScanner]]:
    """A camera, and the backend, not connected; `changes` are those of its entry."""
    simulated = SimulatedCamera(fake_device(name, plant, BehindWire(faults)), faults)
    user_sets: dict[View, str] = {view: view for view in get_args(View)}
    entry = GentlEntry(kind="gentl", producer=await simulated.start(), user_sets=user_sets)
    scanner = GentlScanner(name, entry.model_copy(update=changes))
    try:
        yield simulated, scanner
    finally:
        await scanner.close()
        await simulated.close()


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[GentlScanner]:
    """See `tests.contract.backends.Installed`."""
    async with wired(name, plant, faults) as (_, scanner):
        yield scanner
