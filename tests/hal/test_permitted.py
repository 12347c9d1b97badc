"""Devices behind latch and rules: refused, stopped on the way, abandoned, and raced with trips."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.errors import DeviceFault, DeviceRefused, GuardTripped, Interrupted, NotConnected, SafetyError, SafetyOpen
from hal.guard.inloop import InLoopGuard
from hal.interfaces import Axis, AxisState, GuardLimits, SafetyState
from hal.interlocks import WATCH_S, Permits
from hal.latch import Latch
from hal.permits import AxisName, PermitLimits
from hal.permitted import PermittedAxis, PermittedCameraPark, PermittedChuck
from tests.hal.small import GOOD_SAFETY, SmallAxis, SmallChuck, SmallForce, SmallPark, SmallSafety, SmallToolEnable

NAMES: tuple[AxisName, ...] = ("stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed")
LIMITS = PermitLimits(view_safe_mm=20.0, free_mm=360.0, guns_back_mm=1.0, pressure_low_bar=4.0)
GUARD = GuardLimits("insert", tare_n=1000.0, trip_n=5.0, low_n=-50.0, stale_ms=50.0, block=10)


class Bench:
    """Six small axes behind permits, with guard and latch."""

    def __init__(self) -> None:
        self.latch = Latch()
        self.bare = {name: SmallAxis(name) for name in NAMES}
        self.sensor, self.chuck, self.park, self.safety = SmallForce(), SmallChuck(), SmallPark(), SmallSafety()
        self.guard = InLoopGuard(
            self.sensor, list(self.bare.values()), self.latch, idle_block=500, idle_stale_s=0.05, halt_deadline_s=0.1
        )
        axes: dict[AxisName, Axis] = {**self.bare}
        looked_at = (self.chuck, self.park, self.safety, SmallToolEnable())
        permits = Permits(axes, *looked_at, self.guard, LIMITS, self.latch)
        self.axes = {name: PermittedAxis(name, self.bare[name], permits, 0.02) for name in NAMES}
        self.camera = PermittedCameraPark(self.park, permits)
        self.clamp = PermittedChuck(self.chuck, permits)


def run(main: Coroutine[Any, Any, None]) -> None:
    async def whole() -> None:
        await main
        assert len(asyncio.all_tasks()) == 1, "a task was left"

    run_virtual(whole())


def test_a_permitted_motion_ends_at_its_target() -> None:
    async def main() -> None:
        bench = Bench()
        state = await bench.axes["jack"].move_to(50.0, speed=10.0)
        assert state.position == 50.0
        assert (await bench.axes["stage_x"].home()).homed
        assert (await bench.axes["jack"].read()).position == 50.0

    run(main())


def test_a_refused_motion_never_reaches_the_axis() -> None:
    async def main() -> None:
        bench = Bench()
        bench.chuck.state = replace(bench.chuck.state, clamped_2=False)
        with pytest.raises(DeviceRefused, match="jack: the chuck is not proven"):
            await bench.axes["jack"].move_to(50.0, speed=10.0)
        bench.safety.state = replace(GOOD_SAFETY, estop_released=None)
        for command in (bench.axes["gun_feed"].home, bench.clamp.clamp, bench.clamp.release):
            with pytest.raises(SafetyOpen, match="emergency stop unknown"):
                await command()
        assert all(axis.starts == 0 for axis in bench.bare.values())

    run(main())


@pytest.mark.parametrize("how", ["gone", "hung"])
def test_a_device_that_gives_no_answer_is_unknown(how: str) -> None:
    async def main() -> None:
        bench = Bench()
        if how == "gone":
            bench.park.error = NotConnected("no link", device="camera_park")
        else:
            bench.park.hang = True
        with pytest.raises(DeviceRefused, match="camera"):
            await bench.axes["jack"].move_to(50.0, speed=10.0)
        assert asyncio.get_running_loop().time() <= LIMITS.read_s + 1e-6

    run(main())


def test_a_device_that_uses_up_the_time_does_not_make_others_unknown() -> None:
    async def main() -> None:
        bench = Bench()
        bench.bare["jack"].hang = True
        quick = bench.safety.read

        async def over_a_wire() -> SafetyState:
            await asyncio.sleep(0.01)
            return await quick()

        bench.safety.read = over_a_wire  # type: ignore[method-assign]
        with pytest.raises(DeviceRefused, match="jack does not say where it is"):
            await bench.axes["jack"].move_to(50.0, speed=10.0)
        assert asyncio.get_running_loop().time() <= 2.0 * LIMITS.read_s + 1e-6

    run(main())


def test_a_rule_broken_on_the_way_stops_the_motion() -> None:
    async def main() -> None:
        bench = Bench()
        loop = asyncio.get_running_loop()
        loop.call_later(1.0, lambda: setattr(bench.chuck, "state", replace(bench.chuck.state, clamped_1=False)))
        with pytest.raises(DeviceRefused, match="chuck"):
            await bench.axes["jack"].move_to(300.0, speed=10.0)
        assert loop.time() <= 1.0 + WATCH_S + 1e-6
        assert not bench.bare["jack"].moving

    run(main())


def test_an_abandoned_motion_leaves_the_axis_standing() -> None:
    async def main() -> None:
        bench = Bench()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await bench.axes["jack"].move_to(300.0, speed=10.0)
        assert bench.bare["jack"].halts == 1
        assert not bench.bare["jack"].moving

    run(main())


def test_an_abandoned_motion_of_a_hung_axis_still_ends() -> None:
    async def main() -> None:
        bench = Bench()
        bench.bare["gun_feed"].delay_s = 1e5
        asyncio.get_running_loop().call_later(0.5, lambda: setattr(bench.bare["gun_feed"], "hang", True))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await bench.axes["gun_feed"].home()
        assert asyncio.get_running_loop().time() < 2.0

    run(main())


def test_a_target_that_the_encoder_does_not_confirm_is_a_fault() -> None:
    async def main() -> None:
        bench = Bench()
        bare = bench.bare["gun_table"]

        async def stale(position: float, *, speed: float) -> AxisState:
            return bare.state

        bare.move_to = stale  # type: ignore[method-assign]
        with pytest.raises(DeviceFault, match="reports 90 mm reached, its encoder reads 0 mm"):
            await bench.axes["gun_table"].move_to(90.0, speed=10.0)

    run(main())


def test_a_drive_that_lost_its_power_to_the_safety_circuit_is_a_safety_matter() -> None:
    async def main() -> None:
        bench = Bench()
        bare = bench.bare["jack"]

        async def cut(position: float, *, speed: float) -> AxisState:
            await asyncio.sleep(0.05)
            bench.safety.state = replace(GOOD_SAFETY, sto_released=False)
            raise DeviceFault("torque off", device="jack")

        bare.move_to = cut  # type: ignore[method-assign]
        with pytest.raises(SafetyOpen, match="safe torque off open"):
            await bench.axes["jack"].move_to(-10.0, speed=10.0)

    run(main())


def test_camera_and_jack_never_meet() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.axes["jack"].move_to(50.0, speed=10.0)
        with pytest.raises(DeviceRefused, match="in the camera's way"):
            await bench.camera.go("rotor")
        await bench.axes["jack"].move_to(0.0, speed=10.0)
        swing = asyncio.create_task(bench.camera.go("rotor"))
        await asyncio.sleep(0.1)
        with pytest.raises(DeviceRefused, match="camera"):
            await bench.axes["jack"].move_to(50.0, speed=10.0)
        assert (await swing).position == "rotor"

    run(main())


def test_closing_the_latch_ends_a_motion_that_has_not_begun() -> None:
    async def main() -> None:
        bench = Bench()
        jack = bench.bare["jack"]
        jack.delay_s = 0.05
        move = asyncio.create_task(bench.axes["jack"].move_to(50.0, speed=10.0))
        await asyncio.sleep(0.01)
        bench.latch.close("safe stop", "asked")
        assert bench.latch.end() == {"jack"}
        with pytest.raises(Interrupted, match="asked"):
            await move
        with pytest.raises(SafetyOpen, match="until re-armed: asked"):
            await bench.axes["jack"].move_to(50.0, speed=10.0)
        assert jack.starts == 0

    run(main())


async def _commands(bench: Bench, rng: np.random.Generator) -> int:
    """Motion commands at random instants to random axes; returns how many were let through to their end."""
    done = 0
    for _ in range(int(rng.integers(1, 4))):
        await asyncio.sleep(float(rng.uniform(0.0, 0.012)))
        name = NAMES[int(rng.integers(len(NAMES)))]
        try:
            await bench.axes[name].move_to(float(rng.uniform(-20.0, 20.0)), speed=float(rng.uniform(100.0, 5000.0)))
            done += 1
        except (SafetyError, Interrupted, DeviceRefused):
            pass
    return done


def test_ten_thousand_trips_raced_with_commands_enable_no_motion_again() -> None:
    async def main() -> None:
        rng = np.random.default_rng(20240917)
        bench = Bench()
        finished = 0
        for _ in range(10_000):
            for axis in bench.bare.values():
                axis.delay_s = float(rng.choice([0.0, 0.0005, 0.003]))
            bench.sensor.script = {bench.sensor.sequence + int(rng.integers(12, 35)): 1100.0}
            await bench.guard.arm(GUARD)
            commands = [asyncio.create_task(_commands(bench, rng)) for _ in range(2)]
            with pytest.raises(GuardTripped):
                await bench.guard.window(1.0)
            await bench.guard.disarm()
            starts = {name: axis.starts for name, axis in bench.bare.items()}
            assert not any(axis.moving for axis in bench.bare.values())
            finished += sum(await asyncio.gather(*commands))
            await asyncio.sleep(0.02)
            assert starts == {name: axis.starts for name, axis in bench.bare.items()}
            assert not any(axis.moving for axis in bench.bare.values())
            with pytest.raises(GuardTripped):
                await bench.axes["gun_feed"].move_to(0.0, speed=1.0)
            await bench.guard.rearm()
        assert finished > 1000

    run(main())
