"""The contract of an axis."""

from __future__ import annotations

import asyncio
import math

import pytest

from hal.errors import DeviceFault, DeviceRefused, Interrupted, NotConnected, SafetyOpen
from hal.fake.faults import Fault
from tests.contract.backends import Backend

AXES = {"stage_x": "mm", "stage_y": "mm", "jack": "mm", "shaft_table": "deg", "gun_table": "deg", "gun_feed": "mm"}
EVERY = pytest.mark.parametrize("name", AXES)


@EVERY
def test_it_moves_only_once_homed_and_reads_back_where_it_stands(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            axis = bench.device
            assert axis.unit == AXES[name]
            assert not (await axis.read()).homed
            with pytest.raises(DeviceRefused, match="not homed"):
                await axis.move_to(1.0, speed=1.0)
            assert (await axis.home()).homed
            began = asyncio.get_running_loop().time()
            state = await axis.move_to(2.0, speed=1.0)
            assert state.position == pytest.approx(2.0, abs=0.01)
            assert (state.moving, state.velocity) == (False, 0.0)
            assert 2.0 <= asyncio.get_running_loop().time() - began < 3.0
            assert (await axis.read()).position == state.position

    backend.run(main())


@EVERY
def test_it_keeps_its_limits(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            axis = bench.device
            await axis.home()
            for position in (axis.limits.low - 0.1, axis.limits.high + 0.1, math.nan, math.inf):
                with pytest.raises(DeviceRefused):
                    await axis.move_to(position, speed=1.0)
            for speed in (0.0, -1.0, math.nan, math.inf):
                with pytest.raises(DeviceRefused):
                    await axis.move_to(1.0, speed=speed)
            assert (await axis.read()).position == pytest.approx(0.0, abs=0.01)
            began = asyncio.get_running_loop().time()
            far = axis.limits.high
            await axis.move_to(far, speed=100.0 * axis.limits.max_speed)
            assert asyncio.get_running_loop().time() - began >= far / axis.limits.max_speed

    backend.run(main())


@EVERY
def test_a_halt_interrupts_and_the_old_target_is_never_resumed(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            axis = bench.device
            await axis.home()
            speed = 0.5 * axis.limits.max_speed
            move = asyncio.create_task(axis.move_to(axis.limits.high, speed=speed))
            await asyncio.sleep(0.5)
            assert not (await axis.safe()).safe
            with pytest.raises(DeviceRefused):
                await axis.move_to(0.0, speed=speed)
            began = asyncio.get_running_loop().time()
            await axis.halt()
            assert asyncio.get_running_loop().time() - began < 0.5
            with pytest.raises(Interrupted):
                await move
            assert (await axis.safe()).safe
            here = (await axis.read()).position
            assert 0.0 < here < axis.limits.high
            await axis.rearm()
            await asyncio.sleep(5.0)
            assert (await axis.read()).position == here
            assert (await axis.move_to(0.0, speed=speed)).position == pytest.approx(0.0, abs=0.01)

    backend.run(main())


@EVERY
def test_a_motion_whose_caller_is_gone_does_not_go_on(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            axis = bench.device
            await axis.home()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.5):
                    await axis.move_to(axis.limits.high, speed=0.5 * axis.limits.max_speed)
            await axis.halt()
            here = (await axis.read()).position
            await asyncio.sleep(5.0)
            assert (await axis.read()).position == here < axis.limits.high

    backend.run(main())


@EVERY
@pytest.mark.parametrize(
    ("kind", "error"), [("following_error", DeviceFault), ("home_lost", DeviceRefused), ("stale_target", None)]
)
def test_what_a_failing_drive_says(backend: Backend, name: str, kind: str, error: type[Exception] | None) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, kind, phase="scan")) as bench:
            axis = bench.device
            await axis.home()  # takes what it takes: the fault begins when it has ended
            bench.faults.enter_phase("scan", asyncio.get_running_loop().time())
            await asyncio.sleep(1.0)
            if error is None:
                state = await axis.move_to(2.0, speed=1.0)
                assert state.position == pytest.approx(0.0, abs=0.01), "its encoder tells the truth"
            else:
                with pytest.raises(error):
                    await axis.move_to(2.0, speed=1.0)
            assert (await axis.safe()).safe
            if kind == "home_lost":
                assert not (await axis.read()).homed

    backend.run(main())


@EVERY
def test_a_drive_without_power_stops_by_itself_and_needs_a_rearm(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault("safety", "estop", at_s=20.0, duration_s=10.0)) as bench:
            axis = bench.device
            await axis.home()
            await asyncio.sleep(19.5 - asyncio.get_running_loop().time())
            with pytest.raises(SafetyOpen):
                await axis.move_to(axis.limits.high, speed=0.1 * axis.limits.max_speed)
            assert asyncio.get_running_loop().time() == pytest.approx(20.0, abs=0.25)
            await asyncio.sleep(1.0)
            assert (await axis.safe()).safe
            with pytest.raises(SafetyOpen):
                await axis.move_to(0.0, speed=1.0)
            await asyncio.sleep(10.0)
            with pytest.raises(DeviceRefused):
                await axis.move_to(0.0, speed=1.0)
            await axis.rearm()
            assert (await axis.move_to(0.0, speed=1.0)).position == pytest.approx(0.0, abs=0.01)

    backend.run(main())


def test_unconnected_it_does_nothing(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("jack", connect=False) as bench:
            for command in (bench.device.read, bench.device.home, bench.device.halt, bench.device.rearm):
                with pytest.raises(NotConnected):
                    await command()
            with pytest.raises(NotConnected):
                await bench.device.move_to(1.0, speed=1.0)

    backend.run(main())
