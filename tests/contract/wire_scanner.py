"""The scanner by file drop: a simulated scanner's software serves a folder, the real backend asks there."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

from hal.entries import FileDropEntry
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.scanner import DropFolder
from hal.real.scanner import FileDropScanner
from tests.contract.fakes import fake_device


@contextlib.asynccontextmanager
async def wired(
    name: str, plant: Plant, faults: FaultBook, **numbers: float
) -> AsyncIterator[tuple[DropFolder, FileDropScanner]]:
    """A folder that is served, and the backend, not connected; `numbers` are those of its entry."""
    with tempfile.TemporaryDirectory() as top:
        folder = Path(top) / "drop"
        server = DropFolder(fake_device(name, plant, BehindWire(faults)), faults, folder)
        entry = FileDropEntry(kind="file_drop", folder=folder)
        scanner = FileDropScanner(name, entry.model_copy(update=numbers))
        await server.start()
        try:
            yield server, scanner
        finally:
            await scanner.close()
            await server.close()


@contextlib.asynccontextmanager
async def installed(name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[FileDropScanner]:
    """See `tests.contract.backends.Installed`."""
    async with wired(name, plant, faults) as (_, scanner):
        yield scanner
