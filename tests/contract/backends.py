"""Backends on which the contract cases run. Another backend is another class with the same `bench`."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine
from dataclasses import dataclass
from typing import Any, Protocol

from hal.clock import run_virtual
from hal.fake.faults import Fault, FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.levels import Level
from hal.fake.plant import Plant, TwinSettings
from tests.contract.fakes import fake_device

OPEN_FIT = {"fit_interference_mm": -0.2}
"""The spigot has play, so that the faces meet where the jack brings them."""
COUNT = 12
"""Studs of the joint that the cases work on."""


@dataclass
class Bench:
    """One device on its plant; `plant` and `faults` are the physical side, which a controller never sees."""

    device: Any
    plant: Plant
    faults: FaultBook


class Backend(Protocol):
    """How a device of the cell file is had, connected unless `connect` is false."""

    name: str

    def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: Level = "ideal"
    ) -> contextlib.AbstractAsyncContextManager[Bench]: ...


class FakeBackend:
    """Fakes in this process, under virtual time."""

    name = "fake"

    @contextlib.asynccontextmanager
    async def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: Level = "ideal"
    ) -> AsyncIterator[Bench]:
        plant = Plant(JointGeometry(tuple(360.0 * i / COUNT for i in range(COUNT))), TwinSettings(3, level, OPEN_FIT))
        book = FaultBook(faults)
        made = fake_device(device, plant, book)
        if connect:
            await made.connect()
        try:
            yield Bench(made, plant, book)
        finally:
            await made.close()


def run(main: Coroutine[Any, Any, None]) -> None:
    """Run one case under virtual time; it must leave no task behind."""

    async def whole() -> None:
        await main
        left = [task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        assert not left, f"tasks left: {left}"

    run_virtual(whole())


BACKENDS: tuple[Backend, ...] = (FakeBackend(),)
