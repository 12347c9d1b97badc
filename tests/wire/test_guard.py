"""The guard between controller and drives: what trips it, what it does first, and what is needed to move again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

import pytest

from hal.codec.cia301 import HEARTBEAT, RPDO1, heartbeat
from hal.codec.cia402 import QUICK_STOP, State
from hal.errors import DeviceError, GuardTripped, NotConnected
from hal.guard.link import GuardLink
from tests.wire.guard_stand import LIMITS, NUMBER, WEIGHT_N, GuardStand, on_stand


async def tripped(stand: GuardStand, within_s: float = 2.0) -> str:
    """The reason, once the controller's side knows."""
    await until(lambda: stand.client.state().tripped, within_s)
    return stand.client.state().reason


async def until(come_true: Callable[[], bool], within_s: float) -> None:
    """Look every 5 ms of the loop's time."""
    async with asyncio.timeout(within_s):
        while not come_true():  # noqa: ASYNC110
            await asyncio.sleep(0.005)


async def moving(stand: GuardStand) -> asyncio.Task[object]:
    """The jack on a long way, under the guard."""
    await stand.client.arm(LIMITS)
    move: asyncio.Task[object] = asyncio.create_task(stand.axis.move_to(300.0, speed=10.0))
    await until(lambda: stand.plant.motion["jack"].moving(asyncio.get_running_loop().time()), 5.0)
    return move


def stopped(stand: GuardStand) -> bool:
    return stand.node.drive.state is State.QUICK_STOP_ACTIVE


def test_on_a_trip_the_quick_stop_is_the_first_that_is_sent_and_nothing_enables_until_re_armed() -> None:
    async def case(stand: GuardStand) -> None:
        move = await moving(stand)
        await stand.client.disarm()
        await stand.client.arm(replace(LIMITS, tare_n=WEIGHT_N - 500.0))
        assert "above 200.00 N" in await tripped(stand)
        assert stand.latch.closed
        await until(lambda: stopped(stand), 1.0)  # the word of the trip may be read before the bus is
        sent = [f for f in stand.frames if f.can_id == RPDO1 + NUMBER]
        assert sent[-1].data[0] == QUICK_STOP
        with pytest.raises(DeviceError):
            await move
        assert stopped(stand)
        with pytest.raises(GuardTripped, match="latched"):
            await stand.client.arm(LIMITS)
        with pytest.raises(DeviceError):
            await stand.axis.rearm()
        assert stopped(stand)
        await stand.rearm()
        assert not stand.latch.closed
        assert (await stand.axis.move_to(5.0, speed=20.0)).position == pytest.approx(5.0, abs=0.01)

    on_stand(case)


def test_a_force_cable_that_breaks_trips_while_armed() -> None:
    async def case(stand: GuardStand) -> None:
        move = await moving(stand)
        stand.amplifier.unplug()
        assert "silent for" in await tripped(stand)
        with pytest.raises(DeviceError):
            await move
        assert stopped(stand)
        with pytest.raises(NotConnected):
            await stand.sensor.block(10)
        stand.amplifier.plug()
        await asyncio.sleep(1.0)
        assert len((await stand.sensor.block(10)).samples_n) == 10

    on_stand(case)


def test_a_controller_that_is_silent_is_dead() -> None:
    async def case(stand: GuardStand) -> None:
        move = await moving(stand)
        await stand.beats.close()
        assert "controller is not heard for" in await tripped(stand)
        with pytest.raises(DeviceError):
            await move
        assert stopped(stand)

    on_stand(case)


def test_unarmed_a_silent_controller_costs_the_drives_their_heartbeat() -> None:
    async def case(stand: GuardStand) -> None:
        move = asyncio.create_task(stand.axis.move_to(300.0, speed=10.0))
        await asyncio.sleep(0.5)
        await stand.beats.close()
        assert "no heartbeat went to the drives" in await tripped(stand)
        with pytest.raises(DeviceError):
            await move
        assert stopped(stand)

    on_stand(case)


def test_a_controller_that_hangs_up_leaves_standing_drives_and_a_latched_gate() -> None:
    async def case(stand: GuardStand) -> None:
        move = await moving(stand)
        assert stand.guard.process.server.controller is not None
        stand.guard.process.server.controller.abort()
        assert "lost" in await tripped(stand)
        with pytest.raises(DeviceError):
            await move
        await asyncio.sleep(0.5)
        assert stopped(stand)
        assert "connection ended" in stand.guard.process.sentry.state(0.0).reason
        await stand.rearm()
        assert (await stand.axis.read()).enabled

    on_stand(case)


def test_a_guard_that_dies_is_a_trip_and_one_that_starts_anew_is_latched() -> None:
    async def case(stand: GuardStand) -> None:
        move = await moving(stand)
        await stand.guard.process.close()
        assert "shut down" in await tripped(stand)
        with pytest.raises(DeviceError):
            await move
        with pytest.raises(NotConnected):
            await stand.client.rearm()
        await stand.restart_guard()
        await asyncio.sleep(1.0)
        assert stand.client.state().tripped
        assert stopped(stand)
        with pytest.raises(DeviceError):
            await stand.axis.rearm()
        await stand.rearm()
        assert (await stand.axis.read()).enabled
        assert len((await stand.client.window(0.1)).samples_n) == 100

    on_stand(case)


def test_an_adapter_that_is_gone_is_a_trip_and_no_re_arming_without_it() -> None:
    async def case(stand: GuardStand) -> None:
        move = await moving(stand)
        await stand.guard.hub.unplug()
        assert "no heartbeat went to the drives" in await tripped(stand)
        with pytest.raises(DeviceError):
            await move
        with pytest.raises(NotConnected, match="heartbeat"):
            await stand.client.rearm()
        await stand.guard.hub.start()
        await asyncio.sleep(2.0)
        assert stopped(stand)
        await stand.rearm()
        assert (await stand.axis.read()).enabled

    on_stand(case)


def test_the_drives_heartbeat_is_the_guards_alone() -> None:
    async def case(stand: GuardStand) -> None:
        stand.frames.clear()
        for _ in range(50):
            stand.guard.link.send(heartbeat(127))
        await asyncio.sleep(0.2)
        assert len([frame for frame in stand.frames if frame.can_id == HEARTBEAT + 127]) < 10

    on_stand(case)


def test_a_second_controller_is_sent_away() -> None:
    async def case(stand: GuardStand) -> None:
        second = GuardLink(stand.guard.config.path.parent / "g")
        with pytest.raises(NotConnected):
            await second.reached(within_s=0.5)
        assert not stand.client.state().tripped
        assert (await stand.axis.move_to(5.0, speed=20.0)).position == pytest.approx(5.0, abs=0.01)

    on_stand(case)


def test_a_window_is_read_while_the_guard_watches() -> None:
    async def case(stand: GuardStand) -> None:
        await stand.client.arm(LIMITS)
        block = await stand.client.window(0.2)
        assert len(block.samples_n) == 200
        assert float(block.samples_n.mean()) == pytest.approx(WEIGHT_N, abs=1.0)
        state = await stand.client.disarm()
        assert (state.armed, state.tripped) == (False, False)
        assert state.samples >= 200

    on_stand(case)
