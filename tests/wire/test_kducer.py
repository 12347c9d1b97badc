"""The Kolver gun when wire or controller misbehave: the true error, and no nut tightened twice.

The socket holds nothing here: a program turns freely until its time limit and ends NOK, which is a result like any
other.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from hal.bus.modbus import Line, Link
from hal.bus.modbus_server import WireFault
from hal.codec import kducer as k
from hal.codec.modbus import READ_COILS, READ_INPUT, WRITE_COIL, ExceptionCode, Request, Unsupported
from hal.errors import CellError, DeviceError, DeviceRefused, Interrupted, NotConnected, UnknownOutcome
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.gun_memory import Program, TurnProgram
from hal.fake.wire.kducer import LEVER_S, KducerController
from hal.interfaces import Band
from hal.real.kducer import KducerGun
from tests.contract.backends import WireBackend, plant_of
from tests.contract.wire_gun import SNUG
from tests.contract.wire_kducer import controller_of, entry_of, installed

FREE = replace(SNUG, stage="free", timeout_s=0.8)
LONG = replace(SNUG, stage="long", timeout_s=8.0)
PROGRAMS: tuple[Program, ...] = (FREE, LONG, TurnProgram(90.0, 15.0, 5.0))
WIRE = WireBackend(installed, speed=200.0)
TIMES = 20
Case = Callable[[KducerController, KducerGun], Awaitable[None]]


@contextlib.asynccontextmanager
async def stand(*faults: Fault, connect: bool = True, **more: Any) -> AsyncIterator[tuple[KducerController, KducerGun]]:
    async with controller_of("gun_a", plant_of("ideal"), FaultBook(faults), PROGRAMS, **more) as (controller, gun):
        if connect:
            await gun.connect()
        yield controller, gun


def on_stand(case: Case, *faults: Fault, **more: Any) -> None:
    async def main() -> None:
        async with stand(*faults, **more) as (controller, gun):
            await case(controller, gun)

    WIRE.run(main())


async def linked(gun: KducerGun) -> None:
    """Wait until the link has come back by itself and the spindle stands."""
    for _ in range(200):
        with contextlib.suppress(DeviceError):
            if (await gun.safe()).safe:
                return
        await asyncio.sleep(0.1)
    raise AssertionError("the link did not come back")


async def known(gun: KducerGun, key: str) -> object:
    """The result under `key`, None, or the error that says that it cannot be known."""
    try:
        return await gun.result(key)
    except UnknownOutcome as unknown:
        return unknown


def on_press(controller: KducerController, do: Callable[[int], None]) -> None:
    """Call `do` with 1, 2, ... whenever the lever is set, before it is answered."""
    count = 0

    def watch(request: Request | Unsupported) -> None:
        nonlocal count
        if isinstance(request, Request) and (request.address, request.words) == (k.LEVER, (1,)):
            count += 1
            do(count)

    controller.server.watch = watch


# ------------------------------------------------------------ connecting


def test_who_it_is_and_who_it_must_be() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        identity = await gun.connect()
        assert (identity.vendor, identity.model, identity.serial) == ("Kolver", "KDS-PL35", "1097")
        other = KducerGun("gun_a", entry_of(controller.server.port, serial="7"))
        with pytest.raises(DeviceRefused, match="screwdriver 1097, expected 7"):
            await other.connect()

    on_stand(case, connect=False)


@pytest.mark.parametrize(
    ("at", "word", "match"), [(k.MODE, 1, "sequence mode"), (k.VERSION[0] + 9, 0x3338, "older than v40")]
)
def test_a_controller_in_another_mode_or_too_old_is_refused(at: int, word: int, match: str) -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        (controller._holding if at == k.MODE else controller._input)[at] = word
        with pytest.raises(DeviceRefused, match=match):
            await gun.connect()

    on_stand(case, connect=False)


# ------------------------------------------------------------ programs


def test_only_a_program_that_tells_just_this_is_run() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        for other in (
            replace(FREE, target_torque_nm=10.02),
            replace(FREE, angle_high_deg=7201.0),
            replace(FREE, threshold_torque_nm=5.0),
            replace(FREE, timeout_s=0.9),
            replace(FREE, direction="loosen"),
        ):
            with pytest.raises(DeviceRefused, match=r"no program tells .*1: free, 2: long"):
                await gun.tighten("k1", other)
        with pytest.raises(DeviceRefused, match="target torque"):
            await gun.tighten("k1", replace(FREE, target_torque_nm=1000.0))
        with pytest.raises(DeviceRefused, match="no program tells"):
            await gun.turn(91.0, speed_rpm=15.0, torque_limit_nm=5.0)
        assert (await gun.turn(90.0, speed_rpm=15.0, torque_limit_nm=5.0)).angle_deg == 90.0
        controller.program(1, replace(FREE, torque_high_nm=12.0))
        with pytest.raises(DeviceRefused, match="program 1 was changed"):
            await gun.tighten("k1", FREE)
        assert len(controller.starts) == 1

    on_stand(case)


# ------------------------------------------------------------ results


def test_long_keys_are_kept_as_a_hash_and_a_result_is_told_to_the_next_client() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        key = "gun_a-2b1c9d0e-4f5a-6b7c-8d9e-0f1a2b3c4d5e"
        first = await gun.tighten(key, FREE)
        assert (first.key, first.torque_band, first.ok) == (key, Band.LOW, False)
        await gun.close()
        other = KducerGun("gun_a", entry_of(controller.server.port))
        await other.connect()
        again = await other.result(key)
        assert again is not None
        assert (again.key, again.tightening_id) == (key, first.tightening_id)
        with pytest.raises(DeviceRefused, match="run before"):
            await other.tighten(key, FREE)
        await other.tighten("k2", FREE)
        with pytest.raises(UnknownOutcome, match="only the last result is kept, of 'k2'"):
            await KducerGun.result(other, "k0")
        await other.close()
        assert len(controller.starts) == 2

    on_stand(case)


def test_a_lost_result_is_unknown_and_then_fetched() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        for i in range(TIMES):
            controller.lose_results = 1
            with pytest.raises(UnknownOutcome, match=f"no result came for k{i}"):
                await gun.tighten(f"k{i}", FREE)
            stored = await gun.result(f"k{i}")
            assert stored is not None
            assert stored.key == f"k{i}"
            with pytest.raises(DeviceRefused):
                await gun.tighten(f"k{i}", FREE)
        assert controller.starts == [f"k{i}" for i in range(TIMES)]

    on_stand(case)


def test_nothing_takes_the_place_of_a_result_that_nobody_has_written_down() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        await gun.tighten("k1", FREE)
        hand = Line(Link(port=controller.server.port))
        await hand.open("hand")
        await hand.set_coil(1, k.LEVER, True, device="hand")
        await hand.set_coil(1, k.LEVER, False, device="hand")
        await hand.close("hand")
        assert controller.starts == ["k1"], "the motor stays stopped"

    on_stand(case)


# ------------------------------------------------------------ the lever


def test_a_start_that_is_not_answered_is_not_repeated() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        def mute(count: int) -> None:
            controller.server.faults.append(WireFault("silent", function=WRITE_COIL))

        on_press(controller, mute)
        for i in range(TIMES):
            with pytest.raises(UnknownOutcome, match=f"no result came for k{i}"):
                await gun.tighten(f"k{i}", LONG)
            await linked(gun)
            assert await known(gun, f"k{i}") is None, "it stood before its end"
        assert controller.starts == [f"k{i}" for i in range(TIMES)]

    on_stand(case)


@pytest.mark.parametrize(
    ("function", "late_s"), [(READ_INPUT, 0.8), (READ_COILS, 0.8), (READ_INPUT, LEVER_S + 0.3), (WRITE_COIL, 0.8)]
)
def test_a_lever_that_may_have_been_let_go_of_is_never_pressed_again(function: int, late_s: float) -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        for i in range(TIMES):
            held = random.Random(i).randint(2, 5)

            def late(count: int, held: int = held) -> None:
                if count == held:
                    controller.server.faults.append(WireFault("late", late_s, 1, function))

            on_press(controller, late)
            with pytest.raises(UnknownOutcome):
                await gun.tighten(f"k{i}", LONG)
            await linked(gun)
            told = await known(gun, f"k{i}")
            assert isinstance(told, UnknownOutcome) if function == WRITE_COIL else told is None
        assert controller.starts == [f"k{i}" for i in range(TIMES)]

    on_stand(case)


def test_a_backend_that_is_given_up_leaves_a_standing_spindle() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        watching = KducerGun("gun_a", entry_of(controller.server.port))
        await watching.connect()
        for i, end in enumerate(("cancel", "close", "halt")):
            tighten = asyncio.create_task(gun.tighten(f"k{i}", LONG))
            await asyncio.sleep(1.5)
            assert not (await watching.safe()).safe
            if end == "cancel":
                tighten.cancel()
            elif end == "close":
                await gun.close()
            else:
                await gun.halt()
            await asyncio.sleep(LEVER_S + 0.5)
            assert (await watching.safe()).safe, end
            with pytest.raises((Interrupted, UnknownOutcome, asyncio.CancelledError)):
                await tighten
            await gun.connect()
        await watching.close()
        assert controller.starts == ["k0", "k1", "k2"]

    on_stand(case)


# ------------------------------------------------------------ the link


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("half", 0.0),
        ("late", 0.3),
        ("late", 1.8),
        ("late_half", 0.3),
        ("duplicate", 0.0),
        ("wrong_unit", 0.0),
        ("short", 0.0),
        ("drop", 0.0),
        ("exception", float(ExceptionCode.BUSY)),
        ("exception", float(ExceptionCode.DEVICE_FAILURE)),
    ],
)
def test_whatever_becomes_of_an_answer_nothing_is_started_twice(kind: Any, value: float) -> None:
    rng = random.Random(f"{kind} {value}")

    async def case(controller: KducerController, gun: KducerGun) -> None:
        loop = asyncio.get_running_loop()
        for i in range(TIMES):
            key, fault = f"k{i}", WireFault(kind, value)
            loop.call_later(rng.uniform(0.0, 2.0), controller.server.faults.append, fault)
            error: CellError | None = None
            try:
                done = await gun.tighten(key, FREE)
                assert (done.key, done.ok) == (key, False)
            except CellError as raised:
                error = raised
            controller.server.faults.clear()
            await linked(gun)
            told = await known(gun, key)
            started = controller.starts.count(key)
            assert started <= 1
            if error is None or not isinstance(told, UnknownOutcome | None):
                assert started == 1, (error, told)
            if error is not None and not isinstance(error, UnknownOutcome):
                assert started == 0, error

    on_stand(case)


@pytest.mark.parametrize("seed", range(2))
def test_a_cable_that_is_pulled_at_any_moment_and_plugged_back(seed: int) -> None:
    rng = random.Random(seed)

    async def case(controller: KducerController, gun: KducerGun) -> None:
        for i in range(TIMES):
            await linked(gun)
            key = f"k{i}"
            tighten = asyncio.create_task(gun.tighten(key, FREE))
            await asyncio.sleep(rng.choice((rng.uniform(0.0, 0.5), rng.uniform(0.0, 2.0))))
            await controller.server.close()
            await asyncio.sleep(rng.uniform(0.0, 3.0))
            await controller.server.start()
            try:
                assert (await tighten).key == key
            except NotConnected:
                assert key not in controller.starts
            except UnknownOutcome:
                assert controller.starts.count(key) == 1
            assert controller.starts.count(key) <= 1

    on_stand(case)


def test_a_controller_that_is_restarted_in_mid_tightening_knows_nothing() -> None:
    async def case(controller: KducerController, gun: KducerGun) -> None:
        await gun.tighten("before", FREE)
        for i in range(TIMES):
            tighten = asyncio.create_task(gun.tighten(f"k{i}", LONG))
            await asyncio.sleep(1.5 + 0.1 * i)
            await controller.power_cycle()
            with pytest.raises(UnknownOutcome):
                await tighten
            await linked(gun)
            assert isinstance(await known(gun, f"k{i}"), UnknownOutcome)
            with pytest.raises(DeviceRefused):
                await gun.tighten(f"k{i}", LONG)
        assert controller.starts == ["before", *(f"k{i}" for i in range(TIMES))]
        assert (await gun.tighten("after", FREE)).key == "after"

    on_stand(case)
