"""The contract of a tightening gun. The cases stand under a stud with a nut in the socket, shaft seated."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from hal.errors import DeviceRefused, Interrupted, NotConnected, SafetyOpen, UnknownOutcome
from hal.fake.faults import Fault
from hal.interfaces import Band, TighteningResult
from tests.contract.backends import Backend, Bench
from tests.contract.wire_gun import SNUG as PROGRAM

NAMES = ("gun_a", "gun_b")
EVERY = pytest.mark.parametrize("name", NAMES)


async def ready(bench: Bench) -> None:
    """Shaft up, a nut in the socket, the socket on the stud's end, the nut two turns on its thread."""
    plant, gun = bench.plant, bench.device.name[-1]
    loop = asyncio.get_running_loop()
    plant.start_move("jack", 400.0, speed=1e6, acceleration=1e9, now=loop.time())
    await asyncio.sleep(0.5)
    plant.joints.load_nut(gun)
    plant.start_move("gun_feed", 92.0, speed=50.0, acceleration=400.0, now=loop.time())
    await asyncio.sleep(3.0)
    await bench.device.turn(-30.0, speed_rpm=10.0, torque_limit_nm=6.0)
    await bench.device.turn(720.0, speed_rpm=20.0, torque_limit_nm=6.0)


async def stored(bench: Bench, key: str) -> TighteningResult | None:
    """What is told under `key`; a controller that keeps its last result only may say that it cannot know."""
    try:
        result: TighteningResult | None = await bench.device.result(key)
    except UnknownOutcome:
        return None
    return result


async def turning(bench: Bench) -> None:
    """Wait until the spindle turns: a program takes a while to be chosen."""
    for _ in range(100):
        if not (await bench.device.safe()).safe:
            return
        await asyncio.sleep(0.02)
    raise AssertionError("the spindle stands")


@EVERY
def test_a_program_runs_once_and_leaves_its_result_under_its_key(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            await ready(bench)
            assert await stored(bench, "k1") is None
            result = await bench.device.tighten("k1", PROGRAM)
            assert result.key == "k1"
            assert result.ok
            assert (result.torque_band, result.angle_band) == (Band.OK, Band.OK)
            assert 9.0 <= result.torque_nm <= 11.0
            trace = result.trace
            assert len(trace.time_s) == len(trace.angle_deg) == len(trace.torque_nm) > 50
            assert trace.time_s[0] == 0.0
            assert (np.diff(trace.time_s) > 0).all()
            assert result.torque_nm == pytest.approx(trace.torque_nm.max(), rel=0.02)
            again = await bench.device.result("k1")
            assert again is not None
            assert again.tightening_id == result.tightening_id
            with pytest.raises(DeviceRefused, match="k1"):
                await bench.device.tighten("k1", PROGRAM)
            second = await bench.device.tighten("k2", PROGRAM)
            assert second.tightening_id > result.tightening_id
            assert second.controller_serial == result.controller_serial

    backend.run(main())


@EVERY
def test_a_halt_stops_the_spindle_and_leaves_no_result(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            await ready(bench)
            tighten = asyncio.create_task(bench.device.tighten("k1", PROGRAM))
            await turning(bench)
            with pytest.raises(DeviceRefused):
                await bench.device.turn(10.0, speed_rpm=10.0, torque_limit_nm=5.0)
            await bench.device.halt()
            with pytest.raises(Interrupted):
                await tighten
            assert (await bench.device.safe()).safe
            assert await bench.device.result("k1") is None
            with pytest.raises(DeviceRefused):
                await bench.device.tighten("k1", PROGRAM)

    backend.run(main())


@EVERY
def test_a_lost_result_is_an_unknown_outcome_that_the_controller_still_knows(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "result_lost")) as bench:
            await ready(bench)
            with pytest.raises(UnknownOutcome):
                await bench.device.tighten("k1", PROGRAM)
            found = await bench.device.result("k1")
            assert found is not None
            assert found.key == "k1"
            assert (await bench.device.tighten("k2", PROGRAM)).key == "k2", "lost once"

    backend.run(main())


@EVERY
def test_a_repeated_result_is_never_taken_for_the_one_that_was_asked_for(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "result_repeated", at_s=60.0)) as bench:
            await ready(bench)
            first = await bench.device.tighten("k1", PROGRAM)
            await asyncio.sleep(60.0)
            try:
                again = await bench.device.tighten("k2", PROGRAM)
            except UnknownOutcome:
                pass  # dropped as a repetition, and no other came
            else:
                assert (again.key == "k1") == (again.tightening_id == first.tightening_id)
            found = await bench.device.result("k2")
            assert found is not None
            assert found.key == "k2"
            assert found.tightening_id > first.tightening_id

    backend.run(main())


@EVERY
def test_a_turn_ends_at_its_angle_or_its_torque(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            before = asyncio.get_running_loop().time()
            free = await bench.device.turn(90.0, speed_rpm=5.0, torque_limit_nm=5.0)
            assert free.angle_deg == pytest.approx(90.0, abs=1.0)
            assert free.peak_torque_nm < 5.0
            assert asyncio.get_running_loop().time() - before >= 90.0 / 30.0
            assert (await bench.device.turn(-90.0, speed_rpm=5.0, torque_limit_nm=5.0)).angle_deg < 0.0
            await ready(bench)
            blocked = await bench.device.turn(36_000.0, speed_rpm=60.0, torque_limit_nm=8.0)
            assert blocked.angle_deg < 36_000.0
            assert blocked.peak_torque_nm == pytest.approx(8.0, rel=0.2)

    backend.run(main())


@EVERY
def test_speeds_that_are_none_are_refused(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            for speed in (0.0, -5.0, float("nan")):
                with pytest.raises(DeviceRefused):
                    await bench.device.turn(10.0, speed_rpm=speed, torque_limit_nm=5.0)

    backend.run(main())


@EVERY
def test_without_power_the_spindle_stands(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault("safety", "estop", at_s=2.0)) as bench:
            with pytest.raises(SafetyOpen):
                await bench.device.turn(3600.0, speed_rpm=5.0, torque_limit_nm=5.0)
            assert asyncio.get_running_loop().time() == pytest.approx(2.0, abs=0.2)
            assert (await bench.device.safe()).safe
            with pytest.raises(SafetyOpen):
                await bench.device.tighten("k1", PROGRAM)

    backend.run(main())


def test_unconnected_it_does_nothing(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("gun_a", connect=False) as bench:
            with pytest.raises(NotConnected):
                await bench.device.tighten("k1", PROGRAM)
            with pytest.raises(NotConnected):
                await bench.device.result("k1")

    backend.run(main())
