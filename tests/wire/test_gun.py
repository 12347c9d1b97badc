"""The Open Protocol gun when wire or controller misbehave: the true error, and no nut tightened twice.

The socket holds nothing here: a program turns freely until its time limit and ends NOK, which is a result like any
other.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace

import numpy as np
import pytest

from hal.codec import open_protocol_messages as m
from hal.config import OpenProtocolEntry
from hal.errors import DeviceError, DeviceRefused, DeviceTimeout, Interrupted, NotConnected, UnknownOutcome
from hal.fake.devices.guns import install_joints
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.gun import GunController
from hal.fake.wire.gun_memory import Program, TurnProgram
from hal.interfaces import Band
from hal.real.gun import RESULT_S, OpenProtocolGun
from tests.contract.backends import WireBackend, plant_of
from tests.contract.wire_gun import SNUG, installed

FREE = replace(SNUG, stage="free", timeout_s=2.0)
LONG = replace(SNUG, stage="long", timeout_s=8.0)
PROGRAMS: tuple[Program, ...] = (FREE, LONG, TurnProgram(90.0, 15.0, 5.0))
WIRE = WireBackend(installed, speed=200.0)
Case = Callable[[GunController, OpenProtocolGun], Awaitable[None]]


@contextlib.asynccontextmanager
async def stand(
    *faults: Fault, serial: str = "", connect: bool = True
) -> AsyncIterator[tuple[GunController, OpenProtocolGun]]:
    """A controller and its backend."""
    plant = plant_of("ideal")
    install_joints(plant)
    controller = GunController("gun_a", plant, FaultBook(faults), PROGRAMS)
    port = await controller.start()
    gun = OpenProtocolGun("gun_a", OpenProtocolEntry(kind="open_protocol", host="127.0.0.1", port=port, serial=serial))
    try:
        if connect:
            await gun.connect()
        yield controller, gun
    finally:
        await gun.close()
        await controller.close()


def on_stand(case: Case, *faults: Fault, connect: bool = True) -> None:
    async def main() -> None:
        async with stand(*faults, connect=connect) as (controller, gun):
            await case(controller, gun)

    WIRE.run(main())


async def linked(gun: OpenProtocolGun) -> None:
    """Wait until the link has come back by itself."""
    for _ in range(200):
        with contextlib.suppress(DeviceError):
            await gun.safe()
            return
        await asyncio.sleep(0.25)
    raise AssertionError("the link did not come back")


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
    async def main() -> None:
        async with stand(serial="gun_b-1", connect=False) as (_, gun):
            with pytest.raises(DeviceRefused, match="gun_a-1 answers instead of gun_b-1"):
                await gun.connect()

    WIRE.run(main())


def test_a_second_client_is_refused() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        entry = OpenProtocolEntry(kind="open_protocol", host="127.0.0.1", port=controller.port)
        second = OpenProtocolGun("gun_a", entry)
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
        entry = OpenProtocolEntry(kind="open_protocol", host="127.0.0.1", port=controller.port)
        other = OpenProtocolGun("gun_a", entry)
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


# ------------------------------------------------------------ the wire


@pytest.mark.parametrize("piece", [1, 7, 19, 500])
def test_messages_in_pieces_are_put_together(piece: int) -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        whole = await gun.tighten("k1", FREE)
        controller.wire.piece = piece
        pieces = await gun.tighten("k2", FREE)
        if piece > 1:  # byte by byte the curves take longer than anybody waits
            assert len(pieces.trace.torque_nm) == len(whole.trace.torque_nm)
        assert pieces.key == "k2"

    on_stand(case)


@pytest.mark.parametrize("seed", range(3))
def test_a_link_that_drops_at_any_moment_costs_no_result_and_starts_nothing_twice(seed: int) -> None:
    rng = random.Random(seed)

    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        loop = asyncio.get_running_loop()
        for i in range(20):
            await linked(gun)
            key = f"k{i}"
            moment_s = rng.choice((rng.uniform(0.0, 0.02), rng.uniform(0.0, 2.5), 2.0 + rng.uniform(0.0, 0.1)))
            dropping = loop.call_later(moment_s, controller.drop)
            try:
                assert (await gun.tighten(key, FREE)).key == key
            except NotConnected:
                assert key not in controller.starts, f"dropped after {moment_s} s"
            dropping.cancel()
            await linked(gun)
            assert controller.starts.count(key) == ((await gun.result(key)) is not None)

    on_stand(case)


@pytest.mark.parametrize("mid", [m.IDENTIFIER, m.SELECT, m.ENABLE, m.INPUT_SET])
def test_a_link_that_drops_before_an_answer(mid: int) -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.drop_at = {mid}
        if mid == m.INPUT_SET:
            assert (await gun.tighten("k1", FREE)).key == "k1", "it was started, and its result is fetched"
        else:
            with pytest.raises(NotConnected):
                await gun.tighten("k1", FREE)
            await linked(gun)
            assert (await gun.tighten("k1", FREE)).key == "k1", "nothing had been started"
        assert controller.starts == ["k1"]

    on_stand(case)


def test_a_start_that_is_not_answered_is_not_repeated() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.mute = {m.INPUT_SET}
        for i in range(5):
            await linked(gun)
            assert (await gun.tighten(f"k{i}", LONG)).key == f"k{i}"
        assert controller.starts == [f"k{i}" for i in range(5)]

    on_stand(case)


@pytest.mark.parametrize("seed", range(2))
def test_a_cable_that_is_pulled_and_plugged_back(seed: int) -> None:
    rng = random.Random(seed)

    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        loop = asyncio.get_running_loop()

        def plug() -> None:
            controller.wire.unplugged = False

        def pull() -> None:
            controller.wire.unplugged = True
            loop.call_later(rng.uniform(0.1, 12.0), plug)

        for i in range(10):
            await linked(gun)
            key = f"k{i}"
            loop.call_later(rng.uniform(0.0, 8.0), pull)
            with contextlib.suppress(UnknownOutcome, NotConnected, DeviceTimeout):
                assert (await gun.tighten(key, LONG)).key == key
            await asyncio.sleep(12.0)
            await linked(gun)
            assert controller.starts.count(key) == ((await gun.result(key)) is not None)

    on_stand(case)


def test_a_controller_that_restarts_in_mid_tightening_leaves_the_outcome_unknown() -> None:
    rng = random.Random(1)

    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        for i in range(20):
            await linked(gun)
            tighten = asyncio.create_task(gun.tighten(f"k{i}", FREE))
            await asyncio.sleep(rng.uniform(0.1, 1.9))
            await controller.power_cycle()
            with pytest.raises(UnknownOutcome, match="the spindle stands"):
                await tighten
            assert await gun.result(f"k{i}") is None
            with pytest.raises(DeviceRefused):
                await gun.tighten(f"k{i}", FREE)
        assert controller.starts == [f"k{i}" for i in range(20)]

    on_stand(case)


def test_the_link_is_kept_alive_while_nothing_happens() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        session = gun._link.session()
        await asyncio.sleep(120.0)
        assert gun._link.session() is session

    on_stand(case)


def test_a_silent_client_is_dropped_and_an_unanswered_keep_alive_ends_the_link() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        controller.wire.mute = {m.KEEP_ALIVE}
        before = gun._link.session()
        await asyncio.sleep(14.0)
        controller.wire.mute = set()
        await linked(gun)
        assert gun._link.session() is not before
        _, writer = await asyncio.open_connection("127.0.0.1", controller.port)
        await asyncio.sleep(16.0)
        assert len(controller._server.clients) == 1
        writer.close()

    on_stand(case)


def test_a_request_that_was_not_heard_is_repeated() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        loop, session = asyncio.get_running_loop(), gun._link.session()
        controller.wire.mute = {m.DISABLE}
        loop.call_later(2.0, controller.wire.mute.clear)
        began_s = loop.time()
        await gun.halt()
        assert loop.time() - began_s == pytest.approx(2.4, abs=0.1)
        assert gun._link.session() is session

    on_stand(case)


def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        await asyncio.sleep(1.0)
        session = gun._link.session()
        for number in (1, 2, 3, 1):
            answer = await session.ask(m.numbered(m.SET_ASK, number, 3))
            assert m.read_set(answer).number == number
            await asyncio.sleep(0.3)

    on_stand(case, Fault("gun_a", "late", value=1.3, at_s=1.0, duration_s=4.0))


def test_an_exchange_that_was_given_up_does_not_answer_the_next() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        await asyncio.sleep(1.0)
        session = gun._link.session()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2):
                await session.ask(m.numbered(m.SET_ASK, 1, 3))
        assert m.read_set(await session.ask(m.numbered(m.SET_ASK, 2, 3))).number == 2

    on_stand(case, Fault("gun_a", "late", value=0.5, at_s=1.0))


def test_a_halt_before_the_start_keeps_it_from_starting() -> None:
    async def case(controller: GunController, gun: OpenProtocolGun) -> None:
        for i in range(20):
            tighten = asyncio.create_task(gun.tighten(f"k{i}", FREE))
            for _ in range(2 * i + 1):
                await asyncio.sleep(0)
            await gun.halt()
            ended = asyncio.get_running_loop().time()
            with pytest.raises(Interrupted):
                await tighten
            assert asyncio.get_running_loop().time() - ended < 1.0
            assert (await gun.safe()).safe
            assert await gun.result(f"k{i}") is None

    on_stand(case)
