"""Faults on the wire of Modbus devices: always the true error, nothing done twice, and well again afterwards."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine
from typing import Any

import pytest

from hal.bus.modbus import Lines
from hal.bus.modbus_server import WireFault
from hal.codec import maps
from hal.codec.modbus import WRITE_MANY, ExceptionCode, Framing, Request
from hal.errors import (
    CellError,
    DeviceFault,
    DeviceRefused,
    DeviceTimeout,
    NotConnected,
    UnknownOutcome,
)
from hal.fake.faults import Fault, FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus import SimulatedModbus
from tests.contract.backends import plant_of, quickened
from tests.contract.fakes import fake_device
from tests.contract.wire_modbus import UNIT, device

TIMES = 20
"""How often each fault strikes."""
SPEED = 200.0
FRAMINGS: tuple[Framing, ...] = ("tcp", "rtu")
ON_BOTH = pytest.mark.parametrize("framing", FRAMINGS)


def run(main: Coroutine[Any, Any, None]) -> None:
    quickened(main, SPEED)


class Wired:
    """A real device, its simulator, the plant, and the writes that reached the server."""

    def __init__(self, made: Any, simulated: SimulatedModbus, plant: Plant) -> None:
        self.device, self.simulated, self.plant = made, simulated, plant
        self.server = simulated.server
        self.writes: list[Request] = []
        self.server.watch = lambda request: self.writes.append(request) if request.function == WRITE_MANY else None

    def strike(self, kind: Any, value: float = 0.0, *, times: int = 1, function: int | None = None) -> None:
        self.server.faults.append(WireFault(kind, value, times, function))


@contextlib.asynccontextmanager
async def wired(name: str, *faults: Fault, framing: Framing = "tcp", **numbers: Any) -> AsyncIterator[Wired]:
    plant, book = plant_of("ideal"), FaultBook(faults)
    simulated = SimulatedModbus({UNIT: {0: fake_device(name, plant, book)}}, plant, book, framing)
    made = device(name, port=await simulated.start(), framing=framing, **numbers)
    try:
        await made.connect()
        yield Wired(made, simulated, plant)
    finally:
        await made.close()
        await simulated.close()


BEYOND_S = 1.8
"""Later than the deadline of an exchange, sooner than the worst reply time."""


@ON_BOTH
@pytest.mark.parametrize(
    ("kind", "value", "error"),
    [
        ("silent", 0.0, DeviceTimeout),
        ("half", 0.0, DeviceTimeout),
        ("late", BEYOND_S, DeviceTimeout),
        ("late_half", BEYOND_S, DeviceTimeout),
        ("wrong_unit", 0.0, DeviceTimeout),
        ("short", 0.0, DeviceFault),
        ("drop", 0.0, NotConnected),
        ("duplicate", 0.0, None),
        ("late_half", 0.5, None),
    ],
)
def test_a_spoilt_answer_is_told_and_the_next_one_is_its_own(
    framing: Framing, kind: str, value: float, error: type[CellError] | None
) -> None:
    async def main() -> None:
        async with wired("spigot_tc_1", framing=framing) as wire:
            seen = [await wire.device.read()]
            for _ in range(TIMES):
                wire.strike(kind, value)
                if error is None:
                    seen.append(await wire.device.read())
                else:
                    with pytest.raises(error, match="spigot_tc_1"):
                        await wire.device.read()
                seen.append(await wire.device.read())
            times = [reading.time_s for reading in seen]
            assert times == sorted(set(times)), "an answer was taken for another one"
            assert all(abs(reading.value - 20.0) < 2.0 for reading in seen)

    run(main())


@pytest.mark.parametrize("kind", ["corrupt"])
def test_a_wrong_checksum_on_a_serial_line_is_no_answer(kind: str) -> None:
    async def main() -> None:
        async with wired("pyrometer", framing="rtu") as wire:
            for _ in range(TIMES):
                wire.strike(kind)
                with pytest.raises(DeviceTimeout):
                    await wire.device.read()
                assert abs((await wire.device.read()).value - 20.0) < 2.0

    run(main())


def test_an_old_answer_is_none_on_tcp_and_an_old_reading_on_a_serial_line() -> None:
    async def main(framing: Framing) -> None:
        async with wired("spigot_tc_1", framing=framing) as wire:
            for _ in range(TIMES):
                before = await wire.device.read()
                wire.strike("stale")
                if framing == "tcp":
                    with pytest.raises(DeviceTimeout):
                        await wire.device.read()
                else:
                    assert (await wire.device.read()).time_s == before.time_s

    for framing in FRAMINGS:
        run(main(framing))


@pytest.mark.parametrize(
    ("code", "error"),
    [
        (ExceptionCode.ILLEGAL_FUNCTION, DeviceRefused),
        (ExceptionCode.ILLEGAL_ADDRESS, DeviceRefused),
        (ExceptionCode.ILLEGAL_VALUE, DeviceRefused),
        (ExceptionCode.DEVICE_FAILURE, DeviceFault),
        (ExceptionCode.ACKNOWLEDGE, UnknownOutcome),
        (ExceptionCode.BUSY, DeviceRefused),
        (ExceptionCode.GATEWAY_PATH, NotConnected),
        (ExceptionCode.GATEWAY_TARGET, NotConnected),
        (99, DeviceFault),
    ],
)
@ON_BOTH
def test_each_exception_code_is_its_error(framing: Framing, code: int, error: type[CellError]) -> None:
    async def main() -> None:
        async with wired("gap_probe_1", framing=framing) as wire:
            for _ in range(TIMES):
                wire.strike("exception", code)
                with pytest.raises(error, match=f"exception {int(code)} "):
                    await wire.device.read()
                await wire.device.read()

    run(main())


@ON_BOTH
@pytest.mark.parametrize("kind", ["silent", "half", "late", "drop"])
def test_a_command_whose_answer_is_lost_is_never_sent_again(framing: Framing, kind: str) -> None:
    async def main() -> None:
        async with wired("nut_feeder", framing=framing) as wire:
            full = await wire.device.count()
            wire.writes.clear()
            wire.strike(kind, BEYOND_S, function=WRITE_MANY)
            with pytest.raises(UnknownOutcome if kind == "drop" else DeviceTimeout):
                await wire.device.load("a")
            await asyncio.sleep(10.0)
            assert [request.words for request in wire.writes] == [(1,), (0,)], "set once, then cleared"
            assert (await wire.device.safe()).safe
            assert await wire.device.count() == full - wire.plant.joints.socket_has_nut("a")  # type: ignore[attr-defined]

    run(main())


@ON_BOTH
def test_a_pulled_cable_drops_the_outputs_and_plugged_back_it_goes_on(framing: Framing) -> None:
    async def main() -> None:
        async with wired("camera_park", framing=framing) as wire:
            for _ in range(TIMES):
                swing = asyncio.create_task(wire.device.go("rotor"))
                await asyncio.sleep(1.0)
                await wire.server.close()
                with pytest.raises(NotConnected):
                    await swing
                with pytest.raises(NotConnected):
                    await wire.device.read()
                await asyncio.sleep(5.0)
                assert wire.plant.camera == "moving", "the coupler has stopped the arm on its way"
                await wire.server.start()
                assert (await wire.device.read()).position is None
                assert (await wire.device.safe()).safe
                assert (await wire.device.go("parked")).position == "parked"

    run(main())


def test_a_controller_that_dies_leaves_outputs_to_the_watchdog() -> None:
    async def main() -> None:
        async with wired("chuck") as wire:
            release = asyncio.create_task(wire.device.release())
            await asyncio.sleep(0.5)
            wire.device._line._task.cancel()  # neither monitor nor command is left
            release.cancel()
            await asyncio.gather(release, return_exceptions=True)
            await asyncio.sleep(1.2)
            assert wire.plant.chuck_clamped, "dropped within its second, before the stroke was over"

    run(main())


def test_a_cancelled_command_clears_its_output() -> None:
    async def main() -> None:
        async with wired("camera_park", watchdog_s=10.0) as wire:
            swing = asyncio.create_task(wire.device.go("rotor"))
            await asyncio.sleep(1.0)
            swing.cancel()
            await asyncio.gather(swing, return_exceptions=True)
            await asyncio.sleep(0.5)
            assert wire.writes[-1].words == (0,)
            assert (await wire.device.safe()).safe

    run(main())


def test_power_lost_on_the_way_is_told_as_such() -> None:
    async def main() -> None:
        async with wired("camera_park", Fault("safety", "estop", at_s=1.0)) as wire:
            with pytest.raises(CellError, match="safety circuit") as caught:
                await wire.device.go("rotor")
            assert caught.value.code == "safety_open"

    run(main())


def test_the_heater_goes_off_where_it_hears_nothing_for_its_watchdog_time() -> None:
    async def main() -> None:
        async with wired("heater", watchdog_s=3.0) as wire:
            await wire.device.heat(60.0, ramp_k_per_min=10.0, max_power_w=2000.0)
            await asyncio.sleep(60.0)
            assert (await wire.device.read()).on, "polling feeds the watchdog"
            await wire.server.close()
            await asyncio.sleep(2.0)
            await wire.server.start()
            assert (await wire.device.read()).on
            await wire.server.close()
            await asyncio.sleep(4.0)
            await wire.server.start()
            state = await wire.device.read()
            assert (state.on, state.power_w, state.alarm) == (False, 0.0, "watchdog")
            await wire.device.rearm()
            assert not (await wire.device.read()).on, "nothing is resumed"

    run(main())


def test_orders_are_written_when_they_change_and_not_in_a_cycle() -> None:
    async def main() -> None:
        async with wired("heater") as wire:
            for setpoint_c in (60.0, 60.0, 70.0):
                await wire.device.heat(setpoint_c, ramp_k_per_min=10.0, max_power_w=2000.0)
                await asyncio.sleep(100.0)
            orders = [request for request in wire.writes if request.address == maps.HEATER_ORDER.start]
            assert len(orders) == 2

    run(main())


def test_no_power_without_a_watchdog_that_says_it_is_armed() -> None:
    async def main() -> None:
        async with wired("heater") as wire:
            wire.strike("exception", ExceptionCode.ILLEGAL_ADDRESS, function=WRITE_MANY)
            await wire.device.close()
            wire.simulated.part(UNIT).words[maps.HEATER_WATCHDOG_S.at] = 0  # a power cycle has disarmed it
            with pytest.raises(DeviceRefused):
                await wire.device.connect()
            await wire.device.connect()
            wire.simulated.part(UNIT).words[maps.HEATER_WATCHDOG_S.at] = 0
            state = await wire.device.heat(60.0, ramp_k_per_min=10.0, max_power_w=2000.0)
            assert state.watchdog_armed, "armed anew before power is asked for"

    run(main())


def test_a_frozen_safety_mirror_is_unknown() -> None:
    async def main() -> None:
        async with wired("safety", framing="rtu") as wire:
            assert (await wire.device.read()).ok
            wire.strike("stale", times=50)
            await asyncio.sleep(1.1)
            for _ in range(TIMES):
                state = await wire.device.read()
                assert not state.ok
                assert state.estop_released is None

    run(main())


def test_devices_on_one_serial_line_keep_their_answers_apart() -> None:
    async def main() -> None:
        stuck = {"spigot_tc_1": 101.0, "spigot_tc_2": 102.0, "rotor_tc": 103.0}
        book = FaultBook(Fault(name, "stuck", value=value) for name, value in stuck.items())
        plant = plant_of("ideal")
        fakes = {name: fake_device(name, plant, book) for name in stuck}
        behind = {UNIT: {0: fakes["spigot_tc_1"], 4: fakes["spigot_tc_2"]}, 18: {0: fakes["rotor_tc"]}}
        simulated = SimulatedModbus(behind, plant, book, "rtu")
        port, lines = await simulated.start(), Lines()
        places: dict[str, dict[str, Any]] = {"spigot_tc_1": {}, "spigot_tc_2": {"base": 4}, "rotor_tc": {"unit": 18}}
        made = [device(name, lines, port=port, framing="rtu", **place) for name, place in places.items()]
        await asyncio.gather(*(one.connect() for one in made))
        simulated.server.faults.extend(WireFault("late", BEYOND_S) for _ in range(TIMES))
        for _ in range(2 * TIMES):
            readings = await asyncio.gather(*(one.read() for one in made), return_exceptions=True)
            for reading, value in zip(readings, stuck.values(), strict=True):
                assert isinstance(reading, DeviceTimeout) or reading.value == value  # type: ignore[union-attr]
        assert all(not isinstance(reading, BaseException) for reading in readings)
        await asyncio.gather(*(one.close() for one in made))
        await simulated.close()

    run(main())


def test_another_unit_and_another_serial_number_are_not_connected() -> None:
    async def main() -> None:
        for framing, error in (("tcp", NotConnected), ("rtu", DeviceTimeout)):
            async with wired("spigot_tc_1", framing=framing) as wire:  # type: ignore[arg-type]
                absent = device("spigot_tc_2", port=wire.server.port, framing=framing, unit=99)
                with pytest.raises(error):
                    await absent.connect()
                other = device("spigot_tc_2", port=wire.server.port, framing=framing, serial="TC-4711")
                with pytest.raises(DeviceRefused, match="serial number spigot_tc_1-1, expected TC-4711"):
                    await other.connect()

    run(main())
