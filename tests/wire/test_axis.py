"""An axis whose bus or drive fails: always the true error, never a motion that nobody asked for."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from hal.bus.hub import BusFault, CanHub, Kind
from hal.codec.cia301 import HEARTBEAT, RPDO1, RPDO2, SDO_REPLY, SDO_REQUEST, TPDO1
from hal.codec.cia402 import FEED, MODE_SHOWN, POSITION, START, STATUSWORD, VELOCITY
from hal.codec.lawicel import CanFrame
from hal.codec.sdo import RANGE
from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, Interrupted, NotConnected
from hal.fake.devices.build import AXIS_UNITS
from hal.fake.faults import FaultBook
from hal.fake.wire.can_node import CanNode
from hal.interfaces import Axis
from hal.real.axes import CanAxis
from tests.contract.backends import plant_of, quickened
from tests.contract.wire_axis import Wire, beat, bus_of, entry_of, wired

ROUNDS = 20
SPEED = 50.0


def on_wire(case: Callable[[Wire], Awaitable[None]], *, prepared: bool = True) -> None:
    """Run `case` on a jack of its own, connected and homed unless `prepared` is false."""

    async def main() -> None:
        async with wired("jack", plant_of("ideal"), FaultBook()) as wire:
            if prepared:
                await wire.axis.connect()
                await wire.axis.home()
            await case(wire)

    quickened(main(), SPEED, None)


def under_way(axis: Axis, to: float) -> asyncio.Task[object]:
    return asyncio.create_task(axis.move_to(to, speed=10.0))


async def safe_again(axis: Axis) -> None:
    """Until the axis answers and is safe; then it is proven to stand there and to be refused until re-armed."""
    for _ in range(100):
        try:
            if (await axis.safe()).safe:
                break
        except DeviceError:
            pass
        await asyncio.sleep(0.1)
    here = (await axis.read()).position
    await asyncio.sleep(1.0)
    assert (await axis.read()).position == here
    with pytest.raises((DeviceRefused, DeviceFault), match=r"re-arm first|error|current|0x"):
        await axis.move_to(1.0, speed=1.0)
    await axis.rearm()
    await asyncio.sleep(1.0)
    assert (await axis.read()).position == here


def frames(function: int, node: int, first: int | None = None) -> Callable[[CanFrame], bool]:
    """Frames of one function code, of those with START set where `first` is that bit."""
    return lambda frame: frame.can_id == function + node and (first is None or bool(frame.data[0] & first))


def test_an_adapter_that_is_gone_and_comes_back() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            await wire.hub.unplug()
            with pytest.raises(NotConnected):
                await move
            with pytest.raises(NotConnected):
                await wire.axis.safe()
            await asyncio.sleep(0.5)
            await wire.hub.start()
            await safe_again(wire.axis)
        assert (await wire.axis.move_to(50.0, speed=20.0)).position == pytest.approx(50.0, abs=0.01)

    on_wire(case)


def test_bus_off_is_left_by_opening_the_adapter_anew() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            wire.hub.bus_off()
            with pytest.raises((NotConnected, DeviceTimeout)):
                await move
            await safe_again(wire.axis)

    on_wire(case)


def test_a_controller_that_is_silent_stops_the_drive() -> None:
    async def case(wire: Wire) -> None:
        loop = asyncio.get_running_loop()
        move = under_way(wire.axis, 400.0)
        await asyncio.sleep(0.5)
        wire.beats.cancel()
        began = loop.time()
        with pytest.raises(DeviceFault, match="heartbeat lost"):
            await move
        assert loop.time() - began < 0.7
        await safe_again(wire.axis)

    on_wire(case)


def test_a_drive_that_is_not_heard_is_lost_and_stopped() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            wire.node.muted = True
            with pytest.raises(NotConnected, match="heartbeat"):
                await move
            wire.node.muted = False
            await safe_again(wire.axis)

    on_wire(case)


def test_an_emergency_in_motion_is_told_with_its_reason() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            wire.node.emergency(0x2310)
            with pytest.raises(DeviceFault, match="over-current"):
                await move
            await safe_again(wire.axis)

    on_wire(case)


def test_a_halt_does_not_hide_the_emergency_that_came_first() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            wire.node.emergency(0x2310)
            await asyncio.sleep(0.01)  # the guard feels how it brakes
            await wire.axis.halt()
            with pytest.raises(DeviceFault, match="over-current"):
                await move
            await safe_again(wire.axis)

    on_wire(case)


def test_a_drive_that_restarts_in_motion_is_set_again_before_it_may_move() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            wire.node.restart()
            with pytest.raises((DeviceFault, NotConnected)):
                await move
            await asyncio.sleep(1.0)
            with pytest.raises(DeviceFault, match="restarted"):
                await wire.axis.move_to(1.0, speed=1.0)
            await wire.axis.rearm()
            with pytest.raises(DeviceRefused, match="not homed"):
                await wire.axis.move_to(1.0, speed=1.0)
            await wire.axis.home()

    on_wire(case)


@pytest.mark.parametrize("kind", ["lost", "late", "twice"])
def test_a_start_that_does_not_come_through_in_time_moves_nothing(kind: Kind) -> None:
    async def case(wire: Wire) -> None:
        start = frames(RPDO1, 3, START)
        for at in range(ROUNDS):
            target = 20.0 + at
            wire.hub.faults.append(BusFault(kind, start, delay_s=3.0))
            if kind == "twice":
                assert (await wire.axis.move_to(target, speed=20.0)).position == pytest.approx(target, abs=0.01)
                continue
            before = (await wire.axis.read()).position
            with pytest.raises((DeviceTimeout, DeviceFault)):
                await wire.axis.move_to(target + 50.0, speed=5.0)
            await asyncio.sleep(1.5)
            assert (await wire.axis.safe()).safe
            assert (await wire.axis.read()).position == pytest.approx(before, abs=0.01)
            await wire.axis.rearm()
            assert (await wire.axis.move_to(target, speed=20.0)).position == pytest.approx(target, abs=0.01)

    on_wire(case)


def test_a_set_point_that_is_lost_is_noticed_before_the_start() -> None:
    async def case(wire: Wire) -> None:
        for at in range(ROUNDS):
            wire.hub.faults.append(BusFault("lost", frames(RPDO2, 3)))
            with pytest.raises(DeviceFault, match="was set to"):
                await wire.axis.move_to(30.0 + at, speed=5.0)
            assert (await wire.axis.move_to(20.0 + at, speed=20.0)).position == pytest.approx(20.0 + at, abs=0.01)

    on_wire(case)


@pytest.mark.parametrize("kind", ["lost", "half"])
def test_a_reply_that_does_not_come_is_a_timeout_and_nothing_else(kind: Kind) -> None:
    async def case(wire: Wire) -> None:
        for at in range(ROUNDS):
            wire.hub.faults.append(BusFault(kind, frames(SDO_REPLY, 3)))
            with pytest.raises(DeviceTimeout):
                await wire.axis.read()
            target = 20.0 + at
            assert (await wire.axis.move_to(target, speed=20.0)).position == pytest.approx(target, abs=0.01)
        assert wire.bus.corrupt == (ROUNDS if kind == "half" else 0)

    on_wire(case)


def test_a_late_reply_is_never_taken_for_the_next_answer() -> None:
    async def case(wire: Wire) -> None:
        for at in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.3)
            wire.node.late_next[VELOCITY.index] = 2.2  # which the motion never asks: the reader's own
            with pytest.raises(DeviceTimeout):
                await wire.axis.read()
            state = await wire.axis.read()
            assert state.velocity == 10.0 or not state.moving
            await wire.axis.halt()
            with pytest.raises((DeviceTimeout, Interrupted)):
                await move
            await wire.axis.rearm()
            assert (await wire.axis.move_to(20.0 + at, speed=20.0)).position == pytest.approx(20.0 + at, abs=0.01)

    on_wire(case)


def test_every_frame_twice_changes_nothing() -> None:
    async def case(wire: Wire) -> None:
        wire.hub.faults.append(BusFault("twice", lambda frame: True, count=10**9))
        for at in range(ROUNDS):
            assert (await wire.axis.move_to(20.0 + at, speed=20.0)).position == pytest.approx(20.0 + at, abs=0.01)

    on_wire(case)


def test_without_its_pdos_a_motion_is_followed_by_asking() -> None:
    async def case(wire: Wire) -> None:
        wire.hub.faults.append(BusFault("lost", frames(TPDO1, 3), count=10**9))
        for at in range(ROUNDS):
            assert (await wire.axis.move_to(20.0 + at, speed=20.0)).position == pytest.approx(20.0 + at, abs=0.01)

    on_wire(case)


def test_frames_of_another_node_are_not_its_own() -> None:
    async def case(wire: Wire) -> None:
        send, end = wire.hub.attach(lambda frame: None)
        for at in range(ROUNDS):
            move = asyncio.create_task(wire.axis.move_to(20.0 + at, speed=20.0))
            await asyncio.sleep(0.0)
            for can_id in (SDO_REPLY + 4, TPDO1 + 4, HEARTBEAT + 4, 0x080 + 4):
                send(CanFrame(can_id, bytes(8)))
            send(CanFrame(SDO_REPLY + 3, bytes.fromhex("4B64600000000000")))  # a reply that nobody asked for
            assert (await move).position == pytest.approx(20.0 + at, abs=0.01)  # type: ignore[attr-defined]
        end()

    on_wire(case)


def test_an_aborted_transfer_is_refused_with_object_and_reason() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            wire.node.abort_next.append(RANGE)
            with pytest.raises(DeviceRefused, match=r"0x6041.*value out of range"):
                await wire.axis.read()
        assert (await wire.axis.safe()).safe

    on_wire(case)


def test_another_scale_than_the_cell_file_s_is_refused() -> None:
    async def case(wire: Wire) -> None:
        wire.node.drive.values[FEED] += 1
        with pytest.raises(DeviceRefused, match=r"feed constant.*100001.*100000"):
            await wire.axis.connect()
        with pytest.raises(NotConnected):
            await wire.axis.home()

    on_wire(case, prepared=False)


def test_a_halt_that_is_not_acknowledged_says_so() -> None:
    async def case(wire: Wire) -> None:
        move = under_way(wire.axis, 400.0)
        await asyncio.sleep(0.5)
        lost = BusFault("lost", lambda frame: frame.can_id in (RPDO1 + 3, SDO_REQUEST + 3), count=10**9)
        wire.hub.faults.append(lost)
        with pytest.raises(DeviceTimeout):
            await wire.axis.halt()
        with pytest.raises((Interrupted, DeviceTimeout)):
            await move
        wire.hub.faults.remove(lost)
        assert not (await wire.axis.safe()).safe
        await wire.axis.halt()
        await safe_again(wire.axis)

    on_wire(case)


def test_the_image_of_the_pdos_is_what_the_drive_answers() -> None:
    async def case(wire: Wire) -> None:
        assert (await wire.axis.move_to(20.0, speed=20.0)).position == pytest.approx(20.0, abs=0.01)
        await asyncio.sleep(0.2)
        for entry in (STATUSWORD, MODE_SHOWN, POSITION, VELOCITY):
            assert wire.axis.node.values[entry] == await wire.axis.node.upload(entry)

    on_wire(case)


def test_a_quick_stop_whose_pdo_is_lost_is_written_and_acknowledged() -> None:
    async def case(wire: Wire) -> None:
        for _ in range(ROUNDS):
            move = under_way(wire.axis, 400.0)
            await asyncio.sleep(0.5)
            wire.hub.faults.append(BusFault("lost", frames(RPDO1, 3)))
            await wire.axis.halt()
            with pytest.raises(Interrupted):
                await move
            assert (await wire.axis.safe()).safe
            await wire.axis.rearm()

    on_wire(case)


def test_nodes_share_an_adapter_and_the_last_one_closes_it() -> None:
    async def case(wire: Wire) -> None:
        async def visit() -> None:
            await wire.bus.open()
            await asyncio.sleep(0)
            await wire.bus.release()

        for _ in range(ROUNDS):
            await asyncio.gather(visit(), visit(), visit())
            with pytest.raises(NotConnected, match="closed"):
                wire.bus.send(CanFrame(0x123))
        await wire.axis.connect()
        assert (await wire.axis.safe()).safe

    on_wire(case, prepared=False)


def test_six_drives_share_one_adapter() -> None:
    async def main() -> None:
        plant, hub = plant_of("ideal"), CanHub()
        await hub.start()
        bus = bus_of(hub)
        entries = {name: entry_of(name, number) for number, name in enumerate(AXIS_UNITS, start=1)}
        nodes = [
            CanNode(hub, entry.node, name, plant, FaultBook(), scale=entry.counts_per_unit, feed=entry.feed)
            for name, entry in entries.items()
        ]
        axes = [CanAxis(name, AXIS_UNITS[name], entry, bus) for name, entry in entries.items()]
        beats = asyncio.create_task(beat(bus))
        serials = {identity.serial for identity in await asyncio.gather(*(axis.connect() for axis in axes))}
        assert len(serials) == len(axes)
        await asyncio.gather(*(axis.home() for axis in axes))
        for target in (2.0, 0.0, 3.0):
            states = await asyncio.gather(*(axis.move_to(target, speed=5.0) for axis in axes))
            assert [state.position for state in states] == pytest.approx([target] * len(axes), abs=0.01)
        moves = [under_way(axis, axis.limits.high) for axis in axes]
        await asyncio.sleep(0.3)
        await asyncio.gather(*(axis.halt() for axis in axes))
        assert all(isinstance(error, Interrupted) for error in await asyncio.gather(*moves, return_exceptions=True))
        assert all([(await axis.safe()).safe for axis in axes])
        await asyncio.gather(*(axis.close() for axis in axes))
        beats.cancel()
        await asyncio.wait({beats})
        for node in nodes:
            node.close()
        await hub.close()

    quickened(main(), 5.0, None)
