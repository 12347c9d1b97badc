"""Nuts and guns in the plant: a whole tightening, what neighbours, heat and reaction do, and planted errors."""

import asyncio
import time

import numpy as np
import pytest

from hal.clock import run_virtual
from hal.fake.devices.guns import install_joints
from hal.fake.heat.state import Thermal
from hal.fake.heat.thermal import Zones
from hal.fake.joints.joint import NutState
from hal.fake.joints.nuts import Error
from hal.interfaces import TighteningProgram, TighteningResult
from tests.hal.fake.closed_joint import ALIGNED, FINAL, HALF, OPEN_FIT, SNUG, VERIFY, Bench, closed_joint


async def tighten_pair(bench: Bench, table_deg: float, stage: TighteningProgram) -> list[TighteningResult]:
    await (bench.start_pair if stage is SNUG else bench.engage_pair)(table_deg)
    key = f"{stage.stage}-{table_deg}"
    return list(await asyncio.gather(bench.gun_a.tighten(f"a-{key}", stage), bench.gun_b.tighten(f"b-{key}", stage)))


async def whole(bench: Bench) -> dict[str, list[TighteningResult]]:
    return {
        stage.stage: [
            result for pair in range(18) for result in await tighten_pair(bench, 10.0 * (7 * pair % 18), stage)
        ]
        for stage in (SNUG, HALF, FINAL, VERIFY)
    }


def test_a_whole_tightening_leaves_every_preload_in_its_limits() -> None:
    async def main() -> None:
        bench = await closed_joint()
        results = await whole(bench)
        assert all(result.ok for stage in results.values() for result in stage)
        preload = bench.joints.preload_n()
        assert preload.min() > 10_000.0 and preload.max() < 32_000.0
        assert np.std(preload) / np.mean(preload) == pytest.approx(0.08, abs=0.035)
        assert not bench.joints.yielded().any() and bench.plant.damages == []
        assert max(result.angle_deg for result in results["verify"]) < 10.0

    run_virtual(main())


def test_a_whole_tightening_is_cheap() -> None:
    async def main() -> float:
        bench = await closed_joint()
        began = time.process_time()
        await whole(bench)
        return time.process_time() - began

    # Some 0.4 s of an idle core with plant and loop; ten times that is a step that is no longer vectorised.
    assert run_virtual(main()) < 4.0


def test_same_seed_same_results_and_another_seed_others() -> None:
    async def main(seed: int) -> list[float]:
        bench = await closed_joint(seed=seed)
        return [result.torque_nm for result in await tighten_pair(bench, 0.0, SNUG)]

    first = run_virtual(main(3))
    assert run_virtual(main(3)) == first and run_virtual(main(4)) != first


def test_a_neighbour_loses_preload_and_the_opposite_joint_does_not() -> None:
    async def main() -> None:
        bench = await closed_joint()
        await tighten_pair(bench, 0.0, SNUG)
        before = bench.joints.preload_n()
        await tighten_pair(bench, 10.0, SNUG)
        lost = before - bench.joints.preload_n()
        assert 0.02 < lost[0] / before[0] < 0.12 and 0.02 < lost[18] / before[18] < 0.12
        assert bench.joints.preload_n()[9] == 0.0

    run_virtual(main())


def test_new_parts_come_with_bare_studs() -> None:
    async def main() -> None:
        bench = await closed_joint()
        await tighten_pair(bench, 0.0, SNUG)
        bench.joints.load_nut("a")
        bench.plant.load_parts("R-2", "S-2")
        assert not bench.joints.preload_n().any() and not bench.joints.socket_has_nut("a")

    run_virtual(main())


def test_preload_falls_as_the_heated_flange_cools() -> None:
    async def main() -> None:
        bench = await closed_joint()
        nuts, thermal = bench.joints.nuts, bench.joints.nuts._plant.thermal
        assert isinstance(thermal, Thermal)
        thermal._between = Zones(60.0, 60.0, 20.0, 20.0)
        nuts.follow_temperature()
        nuts.put(0, NutState(present=True, preload_n=20_000.0))
        thermal._between = Zones(40.0, 40.0, 40.0, 40.0)
        nuts.follow_temperature()
        assert nuts.preload_n()[0] == pytest.approx(20_000.0 - 165_663 * 12.5e-6 * 15.6 * 40.0, rel=1e-3)
        assert nuts.preload_n()[1] == 0.0

    run_virtual(main())


@pytest.mark.parametrize(("clamped", "turned"), [(True, False), (False, True)])
def test_reaction_turns_a_shaft_that_nothing_holds(clamped: bool, turned: bool) -> None:
    async def main() -> None:
        bench = await closed_joint()
        bench.plant.set_chuck(clamped=clamped)
        await tighten_pair(bench, 0.0, SNUG)
        slip = bench.plant.slip_deg
        assert (slip == pytest.approx(np.degrees(0.15 / 120.0))) if turned else (slip == 0.0)

    run_virtual(main())


def test_nuts_by_hand_are_on_every_stud_once_the_faces_are_together() -> None:
    async def main() -> None:
        bench = await closed_joint()
        joints = install_joints(bench.plant, nuts_by_hand=True)
        joints.advance(0.0)
        assert all(nut.present and nut.climb_mm == 2.0 for nut in joints.nuts.state)

    run_virtual(main())


@pytest.mark.parametrize("error", ["slip_off", "stripped_thread", "yielded_stud"])
def test_planted_errors_do_not_pass_for_a_tight_joint(error: Error) -> None:
    async def main() -> None:
        bench = await closed_joint()
        bench.joints.plant_error(0, error)
        results: list[TighteningResult] = []
        for stage in (SNUG, HALF, FINAL):
            results.append((await tighten_pair(bench, 0.0, stage))[0])
            if not results[-1].ok:
                break
        assert not results[-1].ok
        assert bench.joints.yielded()[0] == (error != "slip_off")

    run_virtual(main())


def test_a_missing_washer_costs_preload_at_the_same_torque() -> None:
    async def main(washer: bool) -> float:
        bench = await closed_joint(level="ideal")
        if not washer:
            bench.joints.plant_error(0, "missing_washer")
        for stage in (SNUG, HALF, FINAL):
            assert (await tighten_pair(bench, 0.0, stage))[0].ok
        return float(bench.joints.preload_n()[0])

    assert run_virtual(main(False)) < 0.9 * run_virtual(main(True))


def test_a_cross_threaded_nut_stops_the_start_of_the_thread() -> None:
    async def main() -> None:
        bench = await closed_joint()
        bench.joints.plant_error(0, "cross_thread")
        await bench.move("gun_table", 0.0)
        bench.joints.load_nut("a")
        await bench.move("gun_feed", 91.0)
        await bench.gun_a.turn(-360.0, speed_rpm=30.0, torque_limit_nm=6.0)
        met = await bench.gun_a.turn(720.0, speed_rpm=30.0, torque_limit_nm=6.0)
        assert met.angle_deg < 300.0 and met.peak_torque_nm == 6.0

    run_virtual(main())


def test_an_open_joint_with_a_gripped_spigot_needs_more_way() -> None:
    async def main() -> None:
        bench = await closed_joint(overrides=ALIGNED | {"sigma_fit_interference_mm": 0.0})
        # Pressed against the cold spigot the jack cannot close the joint.
        assert bench.plant.gap_mm() > 0.1 and bench.plant.thermal.interference_mm == pytest.approx(0.06)
        condition = bench.joints.nuts.condition(0)
        assert condition.gap_mm > 0.1 and condition.resistance_n >= 0.0
        assert (await tighten_pair(bench, 0.0, SNUG))[0].ok

    run_virtual(main())


def test_the_open_fit_of_these_tests_is_closed() -> None:
    async def main() -> None:
        bench = await closed_joint(overrides=OPEN_FIT)
        assert bench.plant.gap_mm() == 0.0 and bench.plant.thermal.interference_mm == pytest.approx(-0.02)

    run_virtual(main())
