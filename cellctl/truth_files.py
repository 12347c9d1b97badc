"""What is true of the parts in a twin, in files beside a controller that must not know it: DIR/{rotor}-{shaft}.json."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import quote

from cellctl.whole_file import whole_file
from hal.fake.plant import Plant
from hal.fake.truth import TruthLimits, truth_of

RENEWED_S = 2.0
"""A file is at most so much older than what it says; it is final when the run has ended."""


@contextlib.asynccontextmanager
async def keeping_truth(folder: Path | None, plant: Plant, limits: TruthLimits) -> AsyncIterator[None]:
    """Keep the file of the parts that are in, for as long as this lasts; a last time at the end. Raises OSError."""
    if folder is None:
        yield
        return
    keeper = asyncio.get_running_loop().create_task(_keep(folder, plant, limits), name="truth")
    try:
        yield
    finally:
        keeper.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await keeper
        write_truth(folder, plant, limits)


async def _keep(folder: Path, plant: Plant, limits: TruthLimits) -> None:
    while True:
        write_truth(folder, plant, limits)
        await asyncio.sleep(RENEWED_S)


def write_truth(folder: Path, plant: Plant, limits: TruthLimits) -> Path:
    """The file of the parts that are in, replaced whole. Gives its path. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{quote(plant.rotor.serial, safe='')}-{quote(plant.shaft.serial, safe='')}.json"
    told = json.dumps(truth_of(plant, limits).as_dict(), allow_nan=False, indent=1) + "\n"
    with whole_file(path, durable=False) as file:
        file.write(told.encode())
    return path
