"""Backends on which the contract cases run. Another backend is another class with the same `bench`."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Protocol

from hal.clock import QuickenedLoop, run_virtual
from hal.fake.faults import Fault, FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.levels import Level
from hal.fake.plant import Plant, TwinSettings
from tests.contract import (
    wire_axis,
    wire_force,
    wire_gentl,
    wire_guard,
    wire_gun,
    wire_kducer,
    wire_modbus,
    wire_scanner,
)
from tests.contract.fakes import fake_device

OPEN_FIT = {"fit_interference_mm": -0.2}
"""The spigot has play, so that the faces meet where the jack brings them."""
COUNT = 12
"""Studs of the joint that the cases work on."""
SPEED = 20.0
CATCH_UP_S = 0.01
"""Loop time that one busy moment of the machine may cost on the wire: an exchange within its deadline stays so."""


@dataclass
class Bench:
    """One device on its plant; `plant` and `faults` are the physical side, which a controller never sees."""

    device: Any
    plant: Plant
    faults: FaultBook


class Backend(Protocol):
    """How a device of the cell file is had, connected unless `connect` is false, and the loop that a case runs on.

    `simulated` is what its devices must say of themselves; None where they may say either.
    """

    name: str
    simulated: bool | None

    def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: Level = "ideal"
    ) -> contextlib.AbstractAsyncContextManager[Bench]: ...

    def run(self, main: Coroutine[Any, Any, None]) -> None: ...


class Installed(Protocol):
    """How one device of the cell file stands on a plant, not connected: itself and all that it needs around it."""

    def __call__(self, name: str, plant: Plant, faults: FaultBook) -> contextlib.AbstractAsyncContextManager[Any]: ...


def plant_of(level: Level) -> Plant:
    """The twin that all cases work on."""
    return Plant(JointGeometry(tuple(360.0 * i / COUNT for i in range(COUNT))), TwinSettings(3, level, OPEN_FIT))


@contextlib.asynccontextmanager
async def on_bench(
    installed: Installed, device: str, faults: tuple[Fault, ...], connect: bool, level: Level
) -> AsyncIterator[Bench]:
    """A device on a plant of its own, closed in the end."""
    plant, book = plant_of(level), FaultBook(faults)
    async with installed(device, plant, book) as made:
        if connect:
            await made.connect()
        try:
            yield Bench(made, plant, book)
        finally:
            await made.close()


class FakeBackend:
    """Fakes in this process, under virtual time."""

    name = "fake"
    simulated: bool | None = True

    def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: Level = "ideal"
    ) -> contextlib.AbstractAsyncContextManager[Bench]:
        return on_bench(self._installed, device, faults, connect, level)

    @contextlib.asynccontextmanager
    async def _installed(self, name: str, plant: Plant, faults: FaultBook) -> AsyncIterator[Any]:
        yield fake_device(name, plant, faults)

    def run(self, main: Coroutine[Any, Any, None]) -> None:
        run_virtual(alone(main))


class WireBackend:
    """The real backend over its own protocol to a simulator with the plant behind it, `speed` times as fast."""

    simulated: bool | None = True

    def __init__(self, installed: Installed, name: str = "wire", speed: float = SPEED) -> None:
        self.name = name
        self._installed = installed
        self._speed = speed

    def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: Level = "ideal"
    ) -> contextlib.AbstractAsyncContextManager[Bench]:
        return on_bench(self._installed, device, faults, connect, level)

    def run(self, main: Coroutine[Any, Any, None]) -> None:
        quickened(main, self._speed)


async def alone(main: Coroutine[Any, Any, None]) -> None:
    """Run one case; it must leave no task behind."""
    await main
    left = [task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    assert not left, f"tasks left: {left}"


def quickened(main: Coroutine[Any, Any, None], speed: float, catch_up_s: float | None = CATCH_UP_S) -> None:
    """Run one case `speed` times as fast, see `QuickenedLoop`; it must leave no task behind."""
    with asyncio.Runner(loop_factory=partial(QuickenedLoop, speed, catch_up_s)) as runner:
        runner.run(alone(main))


FAKE = FakeBackend()
_MODBUS = WireBackend(wire_modbus.installed, speed=200.0)
_MODBUS_RTU = WireBackend(wire_modbus.installed_rtu, "wire_rtu", speed=200.0)
BACKENDS: Mapping[str, tuple[Backend, ...]] = MappingProxyType(
    {
        "test_axis": (
            FAKE,
            WireBackend(wire_axis.installed),
            WireBackend(wire_guard.installed_axis, "wire_guard"),
        ),
        "test_camera_park": (FAKE, _MODBUS),
        "test_chuck": (FAKE, _MODBUS),
        "test_force_sensor": (
            FAKE,
            WireBackend(wire_force.installed, speed=5.0),
            WireBackend(wire_guard.installed_force, "wire_guard", speed=5.0),
        ),
        "test_gap_probe": (FAKE, _MODBUS),
        "test_gun": (
            FAKE,
            WireBackend(wire_gun.installed, speed=200.0),
            WireBackend(wire_kducer.installed, "wire_kducer", speed=200.0),
        ),
        "test_heater": (FAKE, _MODBUS),
        "test_nut_feeder": (FAKE, _MODBUS),
        "test_part_station": (FAKE, _MODBUS),
        "test_safety": (FAKE, _MODBUS),
        "test_scanner": (
            FAKE,
            WireBackend(wire_scanner.installed),
            WireBackend(wire_gentl.installed, "gentl", speed=10.0),
        ),
        "test_thermometer": (FAKE, _MODBUS, _MODBUS_RTU),
        "test_tool_enable": (FAKE, _MODBUS),
    }
)
"""By test file, where there are others than the fakes; each has a module `wire_...` of its own beside this one."""
