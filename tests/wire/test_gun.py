"""The Open Protocol gun when wire or controller misbehave: the true error, and no nut tightened twice.

The socket holds nothing here: a program turns freely until its time limit and ends NOK, which is a result like any
other.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from hal.errors import CellError, DeviceFault, DeviceRefused, NotConnected, SafetyOpen, UnknownOutcome
from hal.fake.faults import Fault
from hal.fake.wire.gun import ESTOP_ALARM, GunController
from hal.interfaces import Band, Trace
from hal.real.gun import RESULT_S, OpenProtocolGun
from tests.wire.gun_stand import FREE, LONG, entry_of, on_stand

# ------------------------------------------------------------ connecting


@pytest.mark.parametrize(("start", "results"), [(4, 2), (3, 2), (2, 1), (1, 1)])
def test_it_steps_down_to_what_the_controller_knows(start: int, results: int) -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.start_revision, controller.wire.result_revision = start, results
        assert (await gun.connect()).serial == "gun_a-1"
        assert (await gun.tighten("k1", FREE)).torque_band is Band.LOW

    on_stand(case, connect=False)


def test_a_controller_that_knows_no_revision_is_refused() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.start_revision = 0
        with pytest.raises(DeviceRefused, match="MID 0001"):
            await gun.connect()

    on_stand(case, connect=False)


def test_a_controller_without_curves_is_refused() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.curves = False
        with pytest.raises(DeviceRefused, match="no curves"):
            await gun.connect()

    on_stand(case, connect=False)


def test_another_controller_is_refused() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        with pytest.raises(DeviceRefused, match="gun_a-1 answers instead of gun_b-1"):
            await gun.connect()

    on_stand(case, connect=False, serial="gun_b-1")


def test_a_second_client_is_refused() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        second = OpenProtocolGun("gun_a", entry_of(controller))
        with pytest.raises(DeviceRefused, match="client already connected"):
            await second.connect()
        await second.close()
        assert (await gun.safe()).safe

    on_stand(case)


def test_nobody_listens() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        await controller.close()
        with pytest.raises(NotConnected, match=r"127\.0\.0\.1"):
            await gun.connect()

    on_stand(case, connect=False)


# ------------------------------------------------------------ programs


def test_a_program_that_no_parameter_set_tells_is_refused_with_those_that_there_are() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        for other in (
            replace(FREE, target_torque_nm=10.02),
            replace(FREE, angle_high_deg=7201.0),
            replace(FREE, speed_rpm=50.0),
            replace(FREE, direction="loosen"),
        ):
            with pytest.raises(DeviceRefused, match=r"no parameter set tells 'free .*1: free 60 rpm, 2: long"):
                await gun.tighten("k1", other)
        with pytest.raises(DeviceRefused, match="turn 15 rpm"):
            await gun.turn(91.0, speed_rpm=15.0, torque_limit_nm=5.0)
        for key in ("", "x" * 26, " k1", "kä"):
            with pytest.raises(DeviceRefused, match="printable"):
                await gun.tighten(key, FREE)
        assert controller.starts == []
        assert (await gun.turn(90.0, speed_rpm=15.0, torque_limit_nm=5.0)).angle_deg == 90.0

    on_stand(case)


def test_a_parameter_set_that_was_changed_since_is_refused() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.program(1, replace(FREE, torque_high_nm=12.0))
        with pytest.raises(DeviceRefused, match=r"parameter set 1 was changed .* 9 to 12"):
            await gun.tighten("k1", FREE)
        assert controller.starts == []

    on_stand(case)


# ------------------------------------------------------------ results


def test_a_result_is_acknowledged_when_the_next_question_comes() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        await gun.tighten("k1", FREE)
        await gun.safe()
        assert controller.untold == ("k1",), "the caller may not have written it down"
        await gun.tighten("k2", FREE)
        assert controller.untold == ("k2",)
        await gun.result("k2")
        await gun.safe()
        assert controller.untold == ()

    on_stand(case)


def test_a_result_that_nobody_wrote_down_is_told_again_to_the_next_client() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        first = await gun.tighten("k1", FREE)
        await gun.close()
        other = OpenProtocolGun("gun_a", entry_of(controller))
        await other.connect()
        again = await other.result("k1")
        assert again is not None
        assert (again.tightening_id, again.torque_nm) == (first.tightening_id, first.torque_nm)
        assert np.array_equal(again.trace.torque_nm, first.trace.torque_nm), "its curves are asked for"
        with pytest.raises(DeviceRefused, match="k1 was run before"):
            await other.tighten("k1", FREE)
        await other.close()
        assert controller.starts == ["k1"]

    on_stand(case)


def test_a_lost_result_is_unknown_and_then_fetched_with_its_curves() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        for i in range(20):
            controller.wire.lose_results = 1
            with pytest.raises(UnknownOutcome, match=f"no result came for k{i}"):
                await gun.tighten(f"k{i}", FREE)
            stored = await gun.result(f"k{i}")
            assert stored is not None
            assert (stored.key, len(stored.trace.torque_nm) > 100) == (f"k{i}", True)
            with pytest.raises(DeviceRefused):
                await gun.tighten(f"k{i}", FREE)
        assert controller.starts == [f"k{i}" for i in range(20)]

    on_stand(case)


def test_a_late_result_is_waited_for_and_one_that_is_too_late_is_unknown() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.late_result_s = 0.8 * RESULT_S
        assert (await gun.tighten("k1", FREE)).key == "k1"
        controller.wire.late_result_s = 2.0 * RESULT_S
        with pytest.raises(UnknownOutcome):
            await gun.tighten("k2", FREE)
        stored = await gun.result("k2")
        assert stored is not None
        controller.wire.late_result_s = 0.0
        await asyncio.sleep(2.0 * RESULT_S)
        assert (await gun.tighten("k3", FREE)).key == "k3", "what came in between was not taken for it"

    on_stand(case)


def test_repeated_and_strange_results_are_not_taken_for_the_one_that_is_waited_for() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.repeat_results = True
        controller.wire.strange_identifier = "BY HAND"
        results = [await gun.tighten(f"k{i}", FREE) for i in range(20)]
        assert [result.key for result in results] == [f"k{i}" for i in range(20)]
        assert len({result.tightening_id for result in results}) == 20

    on_stand(case)


def test_curves_come_in_the_byte_order_that_the_cell_file_says() -> None:
    traces: list[Trace] = []

    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        traces.append((await gun.tighten("k1", FREE)).trace)

    on_stand(case, order="little", trace_order="little")
    on_stand(case)
    assert np.array_equal(traces[0].torque_nm, traces[1].torque_nm)
    assert traces[0].angle_deg[-1] == pytest.approx(6.0 * FREE.speed_rpm * traces[0].time_s[-1], rel=1e-3)


@pytest.mark.parametrize(("alarms", "error"), [((ESTOP_ALARM,), SafetyOpen), ((), DeviceFault)])
def test_an_alarm_ends_the_run_and_is_the_reason_why_the_next_does_not_start(
    alarms: tuple[str, ...], error: type[CellError]
) -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        with pytest.raises(error, match=ESTOP_ALARM):
            await gun.tighten("k1", LONG)
        with pytest.raises(error, match=ESTOP_ALARM):
            await gun.tighten("k2", LONG)
        assert controller.starts == ["k1"]
        assert await gun.result("k1") is None
        await asyncio.sleep(10.0)
        await gun.rearm()
        assert (await gun.tighten("k2", FREE)).key == "k2", "it had not been started"
        with pytest.raises(DeviceRefused, match="k1 was run before"):
            await gun.tighten("k1", FREE)

    on_stand(case, Fault("safety", "estop", at_s=4.0, duration_s=6.0), estop_alarms=alarms)
