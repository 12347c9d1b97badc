"""Heater and thermometers as devices: regulation, limits, alarms, watchdog, faults."""

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import pytest

from hal.clock import run_virtual
from hal.errors import ConfigError, DeviceRefused, NotConnected, SafetyOpen
from hal.fake.devices.heating import FakeHeater, FakeThermometer, install_heat
from hal.fake.faults import Fault, FaultBook
from hal.fake.plant import Plant, TwinSettings
from hal.interfaces import Heater, Quality, Thermometer
from tests.hal.fake.closed_joint import GEOMETRY


@dataclass(frozen=True, slots=True)
class Oven:
    """Heater and the four channels, the joint open."""

    plant: Plant
    heater: FakeHeater
    tc_1: FakeThermometer
    tc_2: FakeThermometer
    pyrometer: FakeThermometer
    rotor: FakeThermometer

    async def heat(self, setpoint_c: float = 65.0) -> None:
        await self.heater.heat(setpoint_c, ramp_k_per_min=10.0, max_power_w=3000.0)

    async def c(self) -> float:
        return (await self.tc_1.read()).value


def in_oven(test: Callable[[Oven], Awaitable[None]], *faults: Fault) -> None:
    async def main() -> None:
        book = FaultBook(faults)
        plant = Plant(GEOMETRY, TwinSettings(seed=5))
        install_heat(plant)
        names = ("spigot_tc_1", "spigot_tc_2", "pyrometer", "rotor_tc")
        oven = Oven(plant, FakeHeater("heater", plant, book, 4000.0), *(FakeThermometer(n, plant, book) for n in names))
        for device in (oven.heater, oven.tc_1, oven.tc_2, oven.pyrometer, oven.rotor):
            assert (await device.connect()).simulated
        await test(oven)

    run_virtual(main())


def fault(kind: str, *, device: str = "heater", value: float | None = None, at_s: float = 0.0) -> Fault:
    return Fault(device=device, kind=kind, at_s=at_s, value=value)


def test_it_heats_the_spigot_and_leaves_the_rotor_cold() -> None:
    async def test(oven: Oven) -> None:
        heater: Heater = oven.heater
        thermometer: Thermometer = oven.rotor
        state = await heater.heat(65.0, ramp_k_per_min=10.0, max_power_w=3000.0)
        assert state.on and state.setpoint_c == 65.0 and state.watchdog_armed and not state.alarm
        assert not (await heater.safe()).safe
        await asyncio.sleep(600.0)
        assert await oven.c() == pytest.approx(65.0, abs=3.5)
        assert abs((await oven.tc_2.read()).value - await oven.c()) < 2.0
        assert (await oven.pyrometer.read()).value == pytest.approx(await oven.c(), abs=4.0)
        assert (await thermometer.read()).value == pytest.approx(20.0, abs=1.5)
        off = await heater.off()
        assert not off.on and off.power_w == 0.0 and (await heater.safe()).safe
        hot = await oven.c()
        await asyncio.sleep(1800.0)
        assert await oven.c() - 20.0 == pytest.approx((hot - 20.0) * math.exp(-1.0), abs=1.5)

    in_oven(test)


def test_values_out_of_range_are_refused_and_nothing_heats() -> None:
    async def test(oven: Oven) -> None:
        for setpoint_c, ramp, power in ((200.0, 10.0, 3000.0), (65.0, 0.0, 3000.0), (65.0, 10.0, 5000.0)):
            with pytest.raises(DeviceRefused):
                await oven.heater.heat(setpoint_c, ramp_k_per_min=ramp, max_power_w=power)
        with pytest.raises(DeviceRefused):
            await oven.heat(math.nan)
        assert not (await oven.heater.read()).on

    in_oven(test)


def test_halt_takes_the_power_off() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(60.0)
        await oven.heater.halt()
        assert (await oven.heater.safe()).safe
        before = await oven.c()
        await asyncio.sleep(120.0)
        assert await oven.c() < before + 2.0

    in_oven(test)


def test_rearm_makes_the_setpoint_the_measured_value() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(120.0)
        await oven.heater.halt()
        await oven.heater.rearm()
        state = await oven.heater.read()
        assert not state.on and state.setpoint_c == pytest.approx(await oven.c(), abs=1.0)

    in_oven(test)


def test_a_lost_link_trips_the_watchdog_and_a_new_link_sees_the_alarm() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(60.0)
        await oven.heater.close()
        with pytest.raises(NotConnected):
            await oven.heater.read()
        await asyncio.sleep(60.0)
        oven.plant.advance(asyncio.get_running_loop().time())
        await oven.heater.connect()
        state = await oven.heater.read()
        assert state.alarm == "watchdog" and not state.on
        with pytest.raises(DeviceRefused):
            await oven.heat()
        await oven.heater.rearm()
        await oven.heat()
        assert (await oven.heater.read()).on

    in_oven(test)


def test_a_loop_break_shows_as_power_without_rise() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(240.0)
        assert (await oven.heater.read()).power_w > 1500.0 and await oven.c() < 21.0

    in_oven(test, fault("loop_break"))


def test_a_power_stage_stuck_on_runs_into_the_limit_switch() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(240.0)
        state = await oven.heater.read()
        assert state.alarm == "over-temperature" and not state.on
        assert 100.0 < await oven.c() < 180.0

    in_oven(test, fault("stuck_on"))


def test_off_opens_the_contactor_of_a_stage_stuck_on() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(10.0)
        await oven.heater.off()
        await asyncio.sleep(30.0)
        before = await oven.c()
        await asyncio.sleep(60.0)
        assert await oven.c() < before + 0.5

    in_oven(test, fault("stuck_on"))


@pytest.mark.parametrize(("kind", "alarm"), [("watchdog_trip", "watchdog"), ("over_temperature", "over-temperature")])
def test_the_controller_s_own_trips(kind: str, alarm: str) -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(60.0)
        state = await oven.heater.read()
        assert state.alarm == alarm and not state.on

    in_oven(test, fault(kind, at_s=30.0))


def test_a_setpoint_that_is_not_taken_is_read_back_as_it_was() -> None:
    async def test(oven: Oven) -> None:
        state = await oven.heater.heat(65.0, ramp_k_per_min=10.0, max_power_w=3000.0)
        assert math.isnan(state.setpoint_c) and not state.on

    in_oven(test, fault("setpoint_not_taken"))


def test_an_open_safety_circuit_cuts_the_heater() -> None:
    async def test(oven: Oven) -> None:
        await oven.heat()
        await asyncio.sleep(90.0)
        state = await oven.heater.read()
        assert not state.on and "estop" in state.alarm
        with pytest.raises(SafetyOpen):
            await oven.heat()
        with pytest.raises(SafetyOpen):
            await oven.heater.rearm()

    in_oven(test, fault("estop", device="safety", at_s=60.0))


def test_a_wrong_emissivity_reads_low_only_when_it_is_hot() -> None:
    async def test(oven: Oven) -> None:
        assert (await oven.pyrometer.read()).value == pytest.approx(20.0, abs=1.5)
        await oven.heat()
        await asyncio.sleep(600.0)
        assert (await oven.pyrometer.read()).value < await oven.c() - 8.0

    in_oven(test, fault("wrong_emissivity", device="pyrometer", value=0.7))


def test_sensor_faults_reach_the_reading() -> None:
    async def test(oven: Oven) -> None:
        reading = await oven.tc_1.read()
        assert math.isnan(reading.value) and reading.quality == Quality.BAD
        last = (await oven.tc_2.read()).value
        await asyncio.sleep(10.0)
        assert (await oven.tc_2.read()).value == last

    in_oven(test, fault("nan", device="spigot_tc_1"), fault("stuck", device="spigot_tc_2", at_s=5.0))


def test_names_without_a_place_are_refused() -> None:
    plant = Plant(GEOMETRY, TwinSettings())
    with pytest.raises(ConfigError):
        FakeThermometer("oil_tc", plant, FaultBook())
    with pytest.raises(ConfigError):
        run_virtual(FakeHeater("heater", plant, FaultBook(), 4000.0).connect())
