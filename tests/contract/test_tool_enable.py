"""The contract of the bare output that lets the guns turn."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceFault, NotConnected, SafetyOpen
from hal.fake.faults import Fault
from tests.contract.backends import Backend


def test_it_is_off_until_it_is_asked_for_and_off_again_after_a_halt(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("tool_enable") as bench:
            assert not bench.plant.tools_enabled
            state = await bench.device.read()
            assert not state.enabled
            assert state.reason == "not asked for"
            await bench.device.allow()
            await bench.device.allow()
            assert bench.plant.tools_enabled
            state = await bench.device.read()
            assert (state.enabled, state.reason) == (True, "")
            assert state.time_s == pytest.approx(asyncio.get_running_loop().time(), abs=0.1)
            assert not (await bench.device.safe()).safe
            await bench.device.halt()
            assert not bench.plant.tools_enabled
            assert (await bench.device.safe()).safe

    backend.run(main())


def test_re_armed_it_is_off(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("tool_enable") as bench:
            await bench.device.allow()
            await bench.device.rearm()
            assert not bench.plant.tools_enabled

    backend.run(main())


def test_dropped_it_stays_off_until_it_is_switched_off_and_asked_for_anew(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("tool_enable", Fault("tool_enable", "dropped", at_s=5.0)) as bench:
            loop = asyncio.get_running_loop()
            while loop.time() < 5.5:
                if loop.time() < 4.5:
                    await bench.device.allow()
                await asyncio.sleep(0.2)
            assert not bench.plant.tools_enabled
            assert "dropped" in (await bench.device.read()).reason
            with pytest.raises(DeviceFault, match="dropped"):
                await bench.device.allow()
            assert not bench.plant.tools_enabled
            await bench.device.rearm()
            await bench.device.allow()
            assert bench.plant.tools_enabled

    backend.run(main())


def test_without_power_it_is_off_and_cannot_be_asked_for(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("tool_enable", Fault("safety", "estop", at_s=5.0)) as bench:
            loop = asyncio.get_running_loop()
            while loop.time() < 4.5:
                await bench.device.allow()
                await asyncio.sleep(0.2)
            await asyncio.sleep(5.2 - loop.time())
            assert not bench.plant.tools_enabled
            with pytest.raises(SafetyOpen):
                await bench.device.allow()

    backend.run(main())


def test_an_output_that_does_not_switch_on_is_a_fault(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("tool_enable", Fault("tool_enable", "not_taken")) as bench:
            with pytest.raises(DeviceFault):
                await bench.device.allow()
            assert not bench.plant.tools_enabled

    backend.run(main())


def test_unconnected_it_answers_nothing_and_closed_it_is_off(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("tool_enable", connect=False) as bench:
            for command in (bench.device.read, bench.device.allow, bench.device.halt):
                with pytest.raises(NotConnected):
                    await command()
            await bench.device.connect()
            await bench.device.allow()
            await bench.device.close()
            await asyncio.sleep(1.5)
            assert not bench.plant.tools_enabled

    backend.run(main())
