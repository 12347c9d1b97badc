"""What lets the guns turn, over the wire: its coupler's watchdog, and its keeper in the guard."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hal.codec.cia301 import heartbeat
from hal.entries import ModbusEnableEntry
from hal.errors import NotConnected
from hal.fake.faults import Fault, FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus import SimulatedModbus
from hal.guard.enable_client import GuardedToolEnable
from hal.guard.heartbeat import Heartbeat
from hal.guard.logic import Trip
from tests.contract.backends import Bench, plant_of, quickened
from tests.contract.fakes import fake_device
from tests.contract.wire_guard import Guarded, cleared, guarded
from tests.contract.wire_modbus import installed
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase

SPEED = 20.0
WATCHDOG_S = 1.0
NAME = "tool_enable"


@dataclass
class Stand:
    """The controller's side, connected, behind a guard whose gate is open; the guns of `plant` may turn."""

    guard: Guarded
    plant: Plant
    coupler: SimulatedModbus
    enable: GuardedToolEnable


@contextlib.asynccontextmanager
async def standing(faults: FaultBook | None = None) -> AsyncIterator[Stand]:
    """Coupler, guard, controller's side."""
    plant, book = plant_of("ideal"), faults or FaultBook()
    coupler = SimulatedModbus({9: {0: fake_device(NAME, plant, book)}}, plant, book)
    entry = ModbusEnableEntry(kind="modbus", port=await coupler.start(), unit=9, watchdog_s=WATCHDOG_S)
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        async with guarded(Path(folder), **{NAME: entry}) as guard:
            bus, detach = guard.hub.attach(lambda frame: None)
            drive = Heartbeat(lambda: bus(heartbeat(3)), lambda: True, 0.5)  # a bus that is silent is opened anew
            drive.start()
            enable = GuardedToolEnable(NAME, guard.link)
            try:
                yield Stand(guard, plant, coupler, enable)
            finally:
                await enable.close()
                await drive.close()
                detach()
                await coupler.close()


def on_stand(case: Callable[[Stand], Awaitable[None]]) -> None:
    """Run `case` with the guns enabled; no task may be left."""

    async def main() -> None:
        async with standing() as stand:
            await stand.enable.connect()
            await stand.guard.link.open()
            await cleared(stand.guard.link)
            await stand.enable.rearm()
            assert stand.plant.tools_enabled
            await case(stand)
            await stand.guard.link.release()

    quickened(main(), SPEED)


async def falls(stand: Stand, within_s: float) -> None:
    """Wait until the guns are stopped, no longer than `within_s`."""
    fallen = asyncio.Event()
    stand.plant.on_tools(fallen.set)
    async with asyncio.timeout(within_s):
        while stand.plant.tools_enabled:
            await fallen.wait()


def test_nobody_asks_any_more_and_the_coupler_drops_it() -> None:
    async def main() -> None:
        async with installed(NAME, plant := plant_of("ideal"), FaultBook()) as output:
            await output.connect()
            await output.allow()
            await asyncio.sleep(0.8 * WATCHDOG_S)
            await output.allow()
            await asyncio.sleep(0.8 * WATCHDOG_S)
            assert plant.tools_enabled
            await asyncio.sleep(0.5 * WATCHDOG_S)
            assert not plant.tools_enabled
            await output.close()

    quickened(main(), SPEED)


def test_it_stays_on_for_as_long_as_all_is_well() -> None:
    async def case(stand: Stand) -> None:
        for _ in range(50):
            await asyncio.sleep(0.2 * WATCHDOG_S)
            assert stand.plant.tools_enabled
        assert (await stand.enable.read()).enabled

    on_stand(case)


def test_a_trip_takes_it_until_it_is_cleared() -> None:
    async def case(stand: Stand) -> None:
        stand.guard.process.sentry.latch(Trip("too much force"))
        await falls(stand, 0.5)
        assert "tripped" in (await stand.enable.read()).reason
        await stand.enable.rearm()
        await asyncio.sleep(0.5)
        assert not stand.plant.tools_enabled, "the trip is not cleared"
        await cleared(stand.guard.link)
        await asyncio.sleep(0.5)
        assert stand.plant.tools_enabled

    on_stand(case)


def test_a_controller_that_is_silent_or_gone_takes_it() -> None:
    async def case(stand: Stand) -> None:
        await stand.guard.beats.close()
        config = stand.guard.config
        await falls(stand, config.guard.quiet_ms * 1e-3 + config.consumer_s + 0.5)
        assert stand.guard.process.sentry.trip is not None
        stand.guard.beats.start()
        await asyncio.sleep(0.5)
        assert not stand.plant.tools_enabled

    on_stand(case)


def test_a_guard_that_ends_takes_it_with_it() -> None:
    async def case(stand: Stand) -> None:
        await stand.guard.process.close()
        assert not stand.plant.tools_enabled
        with pytest.raises(NotConnected):
            await asyncio.sleep(0.5)
            await stand.enable.read()

    on_stand(case)


def test_a_halt_takes_it_and_proves_it() -> None:
    async def case(stand: Stand) -> None:
        assert not (await stand.enable.safe()).safe
        await stand.enable.halt()
        assert not stand.plant.tools_enabled
        assert (await stand.enable.safe()).safe
        assert not (await stand.enable.read()).enabled

    on_stand(case)


def test_a_pulled_cable_leaves_it_to_the_watchdog_and_plugged_back_it_stays_off() -> None:
    async def case(stand: Stand) -> None:
        await stand.coupler.server.close()
        await falls(stand, WATCHDOG_S + 0.1)
        await stand.coupler.server.start()
        await asyncio.sleep(3.0)
        assert not stand.plant.tools_enabled
        await stand.enable.rearm()
        assert stand.plant.tools_enabled

    on_stand(case)


@contextlib.asynccontextmanager
async def _bench(*faults: Fault) -> AsyncIterator[Bench]:
    book = FaultBook(faults)
    async with standing(book) as stand:
        yield Bench(stand.enable, stand.plant, book)


class _Backend:
    """As `tests.contract.backends.Backend`, through a guard."""

    name = "wire_guard"
    simulated = True

    @contextlib.asynccontextmanager
    async def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: str = "ideal"
    ) -> AsyncIterator[Bench]:
        async with _bench(*faults) as bench:
            if connect:
                await bench.device.connect()
            yield bench

    def run(self, main: Awaitable[None]) -> None:
        quickened(main, SPEED)  # type: ignore[arg-type]


@pytest.mark.parametrize("case", (*CONNECTED[:3], *CONNECTED[4:7], *UNANSWERED))
def test_behind_the_guard_it_is_a_device_like_any_other(case: DeviceCase) -> None:
    case(_Backend(), NAME)  # type: ignore[arg-type]
