"""A cell in a technician's hands: built from its file, none of its devices connected, closed in the end."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable
from pathlib import Path

from hal.cell import EXCHANGE_DEADLINE_S, Cell, build_cell
from hal.config import CellConfig
from hal.errors import CellError, DeviceTimeout, NotConnected
from hal.interfaces import Device
from hal.owner import refuse_second_controller, sole_user


@contextlib.asynccontextmanager
async def opened(config: CellConfig, recipe: Path) -> AsyncIterator[Cell]:
    """The cell of `config`; its fakes, where it has any, on a twin with the parts of `recipe`.

    Raises ConfigError, and DeviceRefused where another controller has the drives.
    """
    with contextlib.ExitStack() as stack:
        if set(config.kinds.values()) != {"fake"}:  # those live in this process
            stack.enter_context(sole_user(config.path))
        await refuse_second_controller(config)
        cell = _built(config, recipe)
        if cell.heartbeat is not None:
            cell.heartbeat.start()
        try:
            with contextlib.suppress(NotConnected):  # the devices behind it say so
                await cell.guard.open()
            yield cell
        finally:
            await cell.close()


def _built(config: CellConfig, recipe: Path) -> Cell:
    if "fake" not in config.kinds.values():
        return build_cell(config)
    # Slow to import, and of no use where nothing is fake.
    from cellctl.recipe import load_recipe
    from cellctl.twin import standing_cell
    from hal.jobs import InlineJobs

    return standing_cell(load_recipe(recipe), config, InlineJobs(), seed=config.twin.seed).cell


async def connected(devices: Iterable[Device]) -> dict[str, CellError]:
    """Connect all at once, each within its deadline; why each of those that failed did."""
    asked = tuple(devices)

    async def one(device: Device) -> CellError | None:
        try:
            async with asyncio.timeout(EXCHANGE_DEADLINE_S):
                await device.connect()
        except TimeoutError:
            return DeviceTimeout(f"did not connect within {EXCHANGE_DEADLINE_S:g} s", device=device.name)
        except CellError as error:
            return error
        return None

    failures = await asyncio.gather(*(one(device) for device in asked))
    return {device.name: error for device, error in zip(asked, failures, strict=True) if error is not None}
