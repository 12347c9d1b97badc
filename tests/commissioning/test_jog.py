"""An axis is jogged under all interlocks, and refused with place, reason, limit and unit."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cellctl.commissioning.bench import opened
from cellctl.commissioning.jog import Jogged, Wish, carry_out, guarded, plan_of, reach, refuse
from cellctl.twin import FakeCell
from hal.cell import Cell, CellFailure
from hal.config import CellConfig
from hal.errors import CellError, DeviceRefused, GuardTripped, SafetyOpen
from hal.fake.fault_file import Fault
from hal.fake.wire.stand import Stand
from tests.commissioning.cells import CONFIG, on_fakes, on_wires
from tests.commissioning.test_survey import fault
from tests.journeys.twin_runs import RECIPE


async def jog(cell: Cell, wish: Wish, config: CellConfig = CONFIG, halt_after_s: float | None = None) -> Jogged:
    """As the command does it, without the question."""
    halt = asyncio.Event()
    if halt_after_s is not None:
        asyncio.get_running_loop().call_later(halt_after_s, halt.set)
    await reach(cell, wish.axis)
    plan = await plan_of(cell, config, wish)
    async with guarded(cell, config, plan):
        await refuse(cell, plan)
        return await carry_out(cell, plan, halt)


@pytest.mark.parametrize(
    ("wish", "position"),
    [
        (Wish("stage_x", to=-3.0), -3.0),
        (Wish("stage_y", by=0.5), 0.5),
        (Wish("shaft_table", to=20.0, speed=10.0), 20.0),
        (Wish("gun_table", by=90.0), 90.0),
        (Wish("gun_feed", to=15.0), 15.0),
        (Wish("jack", to=12.0), 12.0),
        (Wish("jack"), 0.0),
    ],
)
def test_it_arrives_and_is_at_rest(wish: Wish, position: float) -> None:
    async def case(fake: FakeCell) -> None:
        jogged = await jog(fake.cell, wish)
        assert (jogged.end, jogged.reason) == ("arrived", "")
        assert jogged.state.position == pytest.approx(position, abs=0.02)
        assert not jogged.state.moving
        assert "stands at" in jogged.rest

    on_fakes(case, home=True)


def test_it_is_slow_where_no_speed_is_asked() -> None:
    async def case(fake: FakeCell) -> None:
        wishes = (Wish("stage_x", to=1.0), Wish("jack", to=100.0), Wish("jack", to=365.0), Wish("gun_feed", to=5.0))
        plans = [await plan_of(fake.cell, CONFIG, wish) for wish in wishes]
        assert [plan.speed for plan in plans] == [0.5, 2.0, 0.2, 2.0]
        assert plans[0].trip_n is None
        assert plans[1].trip_n == 50.0
        assert plans[2].trip_n is not None
        assert 1.0 < plans[2].trip_n < 10.0
        assert plans[3].trip_n == 25.0

    on_fakes(case, home=True)


@pytest.mark.parametrize(
    ("wish", "told"),
    [
        (Wish("stage_x", to=15.5), r"stage_x: position 15.5 mm is refused \(limit -15 to 15 mm\)"),
        (Wish("stage_x", by=-20.0), r"position -20 mm .*limit -15"),
        (Wish("shaft_table", to=1.0, speed=11.0), r"shaft_table: speed 11 deg/s is refused \(limit 0 to 10 deg/s\)"),
        (Wish("jack", to=370.0, limit_n=12.0), r"jack: force limit 12 N is refused \(limit 0 to 10 N\)"),
        (Wish("stage_x", to=1.0, speed=0.0), r"speed 0 mm/s is refused"),
        (Wish("jack", to=370.0, speed=2.0), r"jack: above 360 mm .* 2 mm/s leaves a trip force of .* N \(limit >= "),
    ],
)
def test_what_is_out_of_its_limits_is_refused_with_the_limit(wish: Wish, told: str) -> None:
    async def case(fake: FakeCell) -> None:
        with pytest.raises(DeviceRefused, match=told):
            await jog(fake.cell, wish)

    on_fakes(case, home=True)


def test_an_axis_that_is_not_homed_goes_nowhere_but_home() -> None:
    async def case(fake: FakeCell) -> None:
        with pytest.raises(DeviceRefused, match="gun_feed: is not homed"):
            await jog(fake.cell, Wish("gun_feed", to=1.0))
        assert (await jog(fake.cell, Wish("gun_feed"))).end == "arrived"
        assert (await jog(fake.cell, Wish("gun_feed", to=0.0))).end == "arrived"

    on_fakes(case)


async def feed_out(cell: Cell) -> None:
    await cell.gun_feed.move_to(20.0, speed=10.0)


async def open_chuck(cell: Cell) -> None:
    await cell.chuck.release()


async def swing_in(cell: Cell) -> None:
    await cell.camera_park.go("rotor")


@pytest.mark.parametrize(
    ("before", "wish", "told"),
    [
        (feed_out, Wish("jack", to=10.0), "guns are not proven back"),
        (feed_out, Wish("gun_table", to=10.0), "guns are not proven back"),
        (open_chuck, Wish("jack", to=10.0), "chuck is not proven clamped"),
        (swing_in, Wish("jack", to=30.0), "camera is not proven parked"),
    ],
)
def test_the_motion_rules_refuse_before_anybody_agrees(before: Callable[[Cell], object], wish: Wish, told: str) -> None:
    async def case(fake: FakeCell) -> None:
        await before(fake.cell)  # type: ignore[misc]
        with pytest.raises(DeviceRefused, match=told):
            await jog(fake.cell, wish)

    on_fakes(case, home=True)


@pytest.mark.parametrize(("kind", "told"), [("estop", "emergency stop"), ("guard_open", "guard doors"), ("gone", "")])
def test_an_open_or_unknown_safety_input_refuses(kind: str, told: str) -> None:
    async def case(fake: FakeCell) -> None:
        await asyncio.sleep(30.0 - asyncio.get_running_loop().time())
        expected = CellFailure if kind == "gone" else SafetyOpen
        with pytest.raises(expected, match=told or "safety"):
            await jog(fake.cell, Wish("stage_x", to=1.0))

    on_fakes(case, replace(fault("safety", kind), at_s=29.0), home=True)


def test_a_safety_input_that_opens_on_the_way_stops_it_with_the_reason() -> None:
    async def case(fake: FakeCell) -> None:
        await asyncio.sleep(30.0 - asyncio.get_running_loop().time())
        jogged = await jog(fake.cell, Wish("stage_x", to=10.0, speed=1.0))
        assert jogged.end == "stopped"
        assert "emergency stop" in jogged.reason
        assert jogged.state.position < 5.0
        assert not jogged.state.moving

    on_fakes(case, replace(fault("safety", "estop"), at_s=33.0), home=True)


def test_on_demand_it_halts_and_says_where_it_stands() -> None:
    async def case(fake: FakeCell) -> None:
        jogged = await jog(fake.cell, Wish("jack", to=100.0, speed=10.0), halt_after_s=5.0)
        assert (jogged.end, jogged.reason) == ("stopped", "halted on demand")
        assert 10.0 < jogged.state.position < 60.0
        assert not jogged.state.moving
        later = await jog(fake.cell, Wish("jack", by=1.0))
        assert later.end == "arrived"
        assert later.state.position == pytest.approx(jogged.state.position + 1.0, abs=0.02)

    on_fakes(case, home=True)


def test_the_jack_that_meets_something_stops_below_the_limit() -> None:
    async def case(fake: FakeCell) -> None:
        await jog(fake.cell, Wish("shaft_table", to=3.0))
        await jog(fake.cell, Wish("jack", to=360.0, speed=20.0))
        jogged = await jog(fake.cell, Wish("jack", to=400.0))
        assert jogged.end == "stopped"
        assert "net force" in jogged.reason
        assert 0.0 < fake.cell.guard.state().peak_n < 10.0
        assert jogged.state.position < 399.0
        with pytest.raises(GuardTripped):
            await fake.cell.jack.move_to(0.0, speed=1.0)
        assert (await jog(fake.cell, Wish("jack", by=-20.0))).end == "arrived"

    on_fakes(case, home=True)


@pytest.mark.parametrize(
    ("planted", "told"),
    [
        (fault("gun_force_a", "drift", 10.0), "gun_force_a: .* N of contact force .limit 25 N"),
        (fault("gun_force_b", "stuck"), "gun_force_b: stands still"),
        (fault("gun_force_b", "gone"), "gun_force_b: .*link"),
    ],
)
def test_the_feed_stops_for_a_contact_force_too_high_or_not_alive(planted: Fault, told: str) -> None:
    async def case(fake: FakeCell) -> None:
        await asyncio.sleep(30.0 - asyncio.get_running_loop().time())
        jogged = await jog(fake.cell, Wish("gun_feed", to=40.0))
        assert jogged.end == "stopped"
        assert re.search(told, jogged.reason)
        assert jogged.state.position < 30.0

    on_fakes(case, replace(planted, at_s=32.0), home=True)


def test_a_sensor_that_is_needed_and_gone_refuses_the_jack() -> None:
    async def case(fake: FakeCell) -> None:
        with pytest.raises(CellError, match="jack_force"):
            await jog(fake.cell, Wish("jack", to=10.0))

    on_fakes(case, fault("jack_force", "gone"))


def test_on_the_wire(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        async with opened(config, RECIPE) as cell:
            for wish in (Wish("gun_feed"), Wish("jack"), Wish("stage_x"), Wish("jack", to=3.0)):
                assert (await jog(cell, wish, config)).end == "arrived"
            jogged = await jog(cell, Wish("stage_x", to=-5.0), config, halt_after_s=3.0)
            assert (jogged.end, jogged.reason) == ("stopped", "halted on demand")
            assert "quick stop active" in jogged.rest
            with pytest.raises(DeviceRefused, match="limit 0 to 420 mm"):
                await jog(cell, Wish("jack", to=421.0), config)

    on_wires(tmp_path, case)
