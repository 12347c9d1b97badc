"""The Open Protocol gun when the link misbehaves: the true error, and no nut tightened twice.

The socket holds nothing here: a program turns freely until its time limit and ends NOK, which is a result like any
other.
"""

from __future__ import annotations

import asyncio
import contextlib
import random

import pytest

from hal.codec import open_protocol_messages as m
from hal.errors import DeviceRefused, DeviceTimeout, Interrupted, NotConnected, UnknownOutcome
from hal.fake.faults import Fault
from hal.fake.wire.gun import GunController
from hal.real.gun import OpenProtocolGun
from tests.wire.gun_stand import FREE, LONG, linked, on_stand


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
