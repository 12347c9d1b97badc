"""The guns as devices: keys, results, halts, lost links, lies, and the socket's search for the hex."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from hal.clock import run_virtual
from hal.errors import ConfigError, DeviceRefused, DeviceTimeout, Interrupted, NotConnected, SafetyOpen, UnknownOutcome
from hal.fake.devices.guns import FakeGun
from hal.fake.faults import Fault, FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.joints.tightening import evaluate
from hal.fake.plant import Plant, TwinSettings
from hal.interfaces import Band, Gun
from tests.hal.fake.closed_joint import EDGE_MM, HALF, SNUG, Bench, closed_joint, program


def on_bench(test: Callable[[Bench], Awaitable[None]], *faults: Fault) -> None:
    async def main() -> None:
        await test(await closed_joint(faults=FaultBook(faults)))

    run_virtual(main())


def fault(kind: str, *, device: str = "gun_a", value: float | None = None, at_s: float = 0.0) -> Fault:
    return Fault(device=device, kind=kind, phase=None, at_s=at_s, value=value)


def test_it_is_a_gun_and_has_no_other_name() -> None:
    plant = Plant(JointGeometry(angles_deg=(0.0, 120.0, 240.0)), TwinSettings())
    gun: Gun = FakeGun("gun_a", plant, FaultBook())
    assert gun.name == "gun_a"
    with pytest.raises(ConfigError):
        FakeGun("gun_c", plant, FaultBook())


def test_nothing_is_done_without_a_link() -> None:
    async def main() -> None:
        plant = Plant(JointGeometry(angles_deg=(0.0, 120.0, 240.0)), TwinSettings())
        with pytest.raises(NotConnected):
            await FakeGun("gun_a", plant, FaultBook()).tighten("k", SNUG)

    run_virtual(main())


def test_a_key_runs_once_and_its_result_is_kept() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        assert await bench.gun_a.result("k-1") is None
        result = await bench.gun_a.tighten("k-1", SNUG)
        assert result.ok and result.key == "k-1" and result.torque_band == Band.OK
        assert await bench.gun_a.result("k-1") == result
        with pytest.raises(DeviceRefused):
            await bench.gun_a.tighten("k-1", SNUG)
        again = await bench.gun_a.tighten("k-2", HALF)
        assert again.tightening_id == result.tightening_id + 1
        assert again.controller_serial == result.controller_serial != bench.joints.guns["b"].serial

    on_bench(test)


def test_the_result_is_the_verdict_of_its_own_trace() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        result = await bench.gun_a.tighten("k", SNUG)
        seen = evaluate(result.trace, SNUG)
        assert (seen.ok, seen.torque_nm, seen.angle_deg) == (result.ok, result.torque_nm, result.angle_deg)

    on_bench(test)


def test_a_halt_interrupts_at_once_and_leaves_no_result() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        loop = asyncio.get_running_loop()
        start = loop.time()
        running = asyncio.create_task(bench.gun_a.tighten("k", SNUG))
        await asyncio.sleep(5.0)
        assert not (await bench.gun_a.safe()).safe
        await bench.gun_a.halt()
        with pytest.raises(Interrupted):
            await running
        assert loop.time() - start == 5.0 and (await bench.gun_a.safe()).safe
        assert await bench.gun_a.result("k") is None
        nut = bench.joints.nuts.state[0]
        assert nut.preload_n == 0.0 and nut.climb_mm == pytest.approx(2.0 + 5.0, abs=0.2)
        with pytest.raises(DeviceRefused):
            await bench.gun_a.tighten("k", SNUG)
        assert (await bench.gun_a.tighten("k-2", SNUG)).ok

    on_bench(test)


def test_a_lost_waiter_does_not_stop_a_running_tightening() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        running = asyncio.create_task(bench.gun_a.tighten("k", SNUG))
        await asyncio.sleep(1.0)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        with pytest.raises(DeviceRefused):
            await bench.gun_a.tighten("k-2", SNUG)
        await asyncio.sleep(30.0)
        result = await bench.gun_a.result("k")
        assert result is not None and result.ok and bench.joints.preload_n()[0] > 3_000.0

    on_bench(test)


def test_a_turn_halted_halfway_has_turned_half() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        before = bench.joints.nuts.state[0].climb_mm
        turning = asyncio.create_task(bench.gun_a.turn(720.0, speed_rpm=10.0, torque_limit_nm=6.0))
        await asyncio.sleep(6.0)
        await bench.gun_a.halt()
        with pytest.raises(Interrupted):
            await turning
        assert bench.joints.nuts.state[0].climb_mm - before == pytest.approx(1.0, abs=0.02)

    on_bench(test)


def test_a_lost_result_is_unknown_and_can_be_asked_for() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        with pytest.raises(UnknownOutcome):
            await bench.gun_a.tighten("k", SNUG)
        result = await bench.gun_a.result("k")
        assert result is not None and result.ok and bench.joints.preload_n()[0] > 3_000.0

    on_bench(test, fault("result_lost"))


def test_a_repeated_result_carries_the_old_key() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        first = await bench.gun_a.tighten("k-1", SNUG)
        assert (await bench.gun_a.tighten("k-2", HALF)).key == "k-1"
        second = await bench.gun_a.result("k-2")
        assert second is not None and second.tightening_id == first.tightening_id + 1

    on_bench(test, fault("result_repeated"))


def test_a_gun_that_grips_nothing_says_ok_but_its_trace_does_not() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        result = await bench.gun_a.tighten("k", SNUG)
        assert result.ok and result.torque_nm == SNUG.target_torque_nm
        assert not evaluate(result.trace, SNUG).ok and bench.joints.preload_n()[0] == 0.0

    on_bench(test, fault("gripped_nothing"))


def test_an_empty_socket_ends_low_by_its_timeout() -> None:
    async def test(bench: Bench) -> None:
        await bench.move("gun_feed", EDGE_MM)
        result = await bench.gun_a.tighten("k", program("snug", 10.0, 60.0, timeout_s=5.0))
        assert not result.ok and result.torque_band == Band.LOW and bench.joints.preload_n()[0] == 0.0
        assert result.time_s == pytest.approx(asyncio.get_running_loop().time())

    on_bench(test)


def test_a_fault_that_names_a_joint_strikes_there() -> None:
    async def test(bench: Bench) -> None:
        for table_deg in (0.0, 10.0):
            await bench.start_pair(table_deg)
            await bench.gun_a.tighten(f"k-{table_deg}", SNUG)
        assert bench.joints.yielded().nonzero()[0].tolist() == [1]

    on_bench(test, fault("stripped_thread", value=1))


def test_the_socket_searches_the_hex_and_its_turn_shows_when_it_is_found() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        await asyncio.gather(bench.gun_a.tighten("a", SNUG), bench.gun_b.tighten("b", SNUG))
        await bench.move("gun_feed", 0.0)
        assert (await bench.gun_a.turn(17.0, speed_rpm=5.0, torque_limit_nm=6.0)).angle_deg == 17.0
        await bench.move("gun_feed", EDGE_MM + 1.5)
        rests = (await bench.force_a.block(5)).samples_n.mean()
        met = await bench.gun_a.turn(20.0, speed_rpm=5.0, torque_limit_nm=2.0)
        assert met.angle_deg == 20.0 and met.peak_torque_nm < 1.0
        met = await bench.gun_a.turn(50.0, speed_rpm=5.0, torque_limit_nm=2.0)
        assert met.angle_deg < 50.0 and met.peak_torque_nm == 2.0
        dropped = (await bench.force_a.block(5)).samples_n.mean()
        assert rests > 8.0 and dropped < 3.0

    on_bench(test)


def test_loosening_frees_a_tight_nut_so_that_it_can_be_redone() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        assert (await bench.gun_a.tighten("k-1", SNUG)).ok
        back = program("loosen", 36.0, 20.0, torque_low_nm=0.0, angle_high_deg=360.0, direction="loosen")
        await bench.gun_a.tighten("k-2", back)
        assert bench.joints.preload_n()[0] == 0.0 and bench.joints.nuts.state[0].present
        assert (await bench.gun_a.tighten("k-3", SNUG)).ok and bench.joints.preload_n()[0] > 3_000.0

    on_bench(test)


def test_a_thread_not_found_backwards_may_start_askew_but_a_found_one_never_does() -> None:
    async def crossed(bench: Bench, reverse: bool) -> int:
        for pair in range(18):
            await bench.move("gun_feed", 0.0)
            await bench.move("gun_table", 10.0 * pair)
            bench.joints.load_nut("a")
            await bench.move("gun_feed", 91.0)
            if reverse:
                await bench.gun_a.turn(-360.0, speed_rpm=60.0, torque_limit_nm=6.0)
            await bench.gun_a.turn(720.0, speed_rpm=60.0, torque_limit_nm=6.0)
        return sum(nut.crossed for nut in bench.joints.nuts.state)

    async def both() -> tuple[int, int]:
        counts = [0, 0]
        for seed in range(3):
            for reverse in (False, True):
                counts[reverse] += await crossed(await closed_joint(seed=seed), reverse)
        return counts[0], counts[1]

    blind, found = run_virtual(both())
    assert found == 0 < blind


def test_a_cut_of_power_stops_the_spindle_when_it_happens() -> None:
    async def test(bench: Bench) -> None:
        await bench.start_pair(0.0)
        loop = asyncio.get_running_loop()
        cut_s = 130.0
        assert loop.time() < cut_s
        await asyncio.sleep(cut_s - 5.0 - loop.time())
        with pytest.raises(SafetyOpen):
            await bench.gun_a.tighten("k", SNUG)
        assert loop.time() == pytest.approx(cut_s) and (await bench.gun_a.safe()).safe
        with pytest.raises(SafetyOpen):
            await bench.gun_a.turn(10.0, speed_rpm=5.0, torque_limit_nm=6.0)

    on_bench(test, fault("estop", device="safety", at_s=130.0))


def test_a_hung_gun_does_not_answer_its_halt() -> None:
    async def test(bench: Bench) -> None:
        with pytest.raises(DeviceTimeout):
            await bench.gun_a.halt()

    async def main() -> None:
        bench = await closed_joint(faults=FaultBook([fault("hung", at_s=1.0)]))
        await asyncio.sleep(2.0)
        await test(bench)

    run_virtual(main())


def test_what_cannot_be_run_is_refused() -> None:
    async def test(bench: Bench) -> None:
        with pytest.raises(DeviceRefused):
            await bench.gun_a.turn(10.0, speed_rpm=0.0, torque_limit_nm=6.0)
        with pytest.raises(DeviceRefused):
            await bench.gun_a.tighten("k", program("snug", 10.0, 0.0))

    on_bench(test)
