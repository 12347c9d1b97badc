"""The contract of the heater controller."""

from __future__ import annotations

import asyncio
import math

import pytest

from hal.errors import DeviceError, DeviceRefused, NotConnected, SafetyOpen
from hal.fake.faults import Fault
from tests.contract.backends import Backend, Bench


async def heat(bench: Bench, setpoint_c: float = 60.0) -> None:
    await bench.device.heat(setpoint_c, ramp_k_per_min=10.0, max_power_w=3000.0)


def test_it_heats_to_the_setpoint_within_its_power_and_goes_off(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater") as bench:
            state = await bench.device.read()
            assert (state.on, state.power_w, state.alarm) == (False, 0.0, "")
            assert state.watchdog_armed
            state = await bench.device.heat(60.0, ramp_k_per_min=10.0, max_power_w=2000.0)
            assert state.on
            assert state.setpoint_c == 60.0
            powers = []
            for _ in range(60):
                await asyncio.sleep(15.0)
                powers.append((await bench.device.read()).power_w)
            assert 0.0 <= min(powers) <= max(powers) <= 2000.0
            assert max(powers) > 200.0
            assert bench.plant.thermal.shaft_c == pytest.approx(60.0, abs=3.0)
            assert not (await bench.device.safe()).safe
            off = await bench.device.off()
            assert (off.on, off.power_w) == (False, 0.0)
            assert (await bench.device.safe()).safe

    backend.run(main())


def test_a_halt_is_off_and_nothing_is_resumed(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater") as bench:
            await heat(bench)
            await asyncio.sleep(30.0)
            await bench.device.halt()
            assert (await bench.device.safe()).safe
            await bench.device.rearm()
            await asyncio.sleep(30.0)
            state = await bench.device.read()
            assert (state.on, state.power_w) == (False, 0.0)
            assert state.setpoint_c == pytest.approx(bench.plant.thermal.shaft_c, abs=15.0)

    backend.run(main())


@pytest.mark.parametrize(
    ("setpoint_c", "ramp", "power_w"),
    [
        (60.0, 10.0, 1e6),
        (60.0, 10.0, 0.0),
        (60.0, 10.0, math.nan),
        (60.0, 0.0, 100.0),
        (60.0, math.nan, 100.0),
        (math.nan, 10.0, 100.0),
        (900.0, 10.0, 100.0),
    ],
)
def test_what_it_cannot_keep_it_refuses(backend: Backend, setpoint_c: float, ramp: float, power_w: float) -> None:
    async def main() -> None:
        async with backend.bench("heater") as bench:
            with pytest.raises(DeviceRefused):
                await bench.device.heat(setpoint_c, ramp_k_per_min=ramp, max_power_w=power_w)
            assert not (await bench.device.read()).on

    backend.run(main())


def test_a_broken_loop_is_power_without_a_rise(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater", Fault("heater", "loop_break")) as bench:
            await heat(bench)
            await asyncio.sleep(300.0)
            assert (await bench.device.read()).power_w > 100.0
            assert bench.plant.thermal.shaft_c == pytest.approx(20.0, abs=0.5)

    backend.run(main())


def test_a_power_stage_that_sticks_is_switched_off_by_the_contactor(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater", Fault("heater", "stuck_on", at_s=100.0)) as bench:
            await heat(bench, 40.0)
            for _ in range(900):
                await asyncio.sleep(1.0)
                assert not (await bench.device.safe()).safe
                if bench.plant.thermal.shaft_c > 45.0:
                    break
            assert bench.plant.thermal.shaft_c > 45.0, "it heats on beyond its set-point"
            await bench.device.halt()
            assert (await bench.device.safe()).safe, "the contactor is not the power stage"

    backend.run(main())


@pytest.mark.parametrize("kind", ["watchdog_trip", "over_temperature"])
def test_its_own_protection_takes_the_power_and_says_why(backend: Backend, kind: str) -> None:
    async def main() -> None:
        async with backend.bench("heater", Fault("heater", kind, at_s=60.0, duration_s=10.0)) as bench:
            await heat(bench)
            await asyncio.sleep(65.0)
            state = await bench.device.read()
            assert not state.on
            assert state.alarm
            with pytest.raises(DeviceRefused, match="alarm"):
                await heat(bench)
            await asyncio.sleep(20.0)
            await bench.device.rearm()
            assert (await bench.device.read()).alarm == ""

    backend.run(main())


def test_a_setpoint_that_is_not_taken_is_read_back_as_it_is(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater", Fault("heater", "setpoint_not_taken")) as bench:
            try:
                state = await bench.device.heat(60.0, ramp_k_per_min=10.0, max_power_w=3000.0)
            except DeviceError:
                return
            assert state.setpoint_c != 60.0

    backend.run(main())


def test_no_power_no_heat(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater", Fault("safety", "sto_open", at_s=60.0)) as bench:
            await heat(bench)
            await asyncio.sleep(61.0)
            state = await bench.device.read()
            assert not state.on
            with pytest.raises(SafetyOpen):
                await heat(bench)

    backend.run(main())


def test_unconnected_it_does_nothing(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("heater", connect=False) as bench:
            for command in (bench.device.read, bench.device.off, bench.device.halt):
                with pytest.raises(NotConnected):
                    await command()

    backend.run(main())
