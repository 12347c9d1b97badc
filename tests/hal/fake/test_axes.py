"""Fake axes beyond their contract: what the plant feels of a drive's start, stop, faults and lost link."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from hal.clock import run_virtual
from hal.errors import DeviceFault, DeviceTimeout, Interrupted, NotConnected
from hal.fake.devices.axes import FakeAxis
from hal.fake.faults import Fault, FaultBook
from hal.fake.plant import Plant
from hal.interfaces import AxisLimits
from tests.hal.fake.bench_plant import plant_of

JACK = AxisLimits(0.0, 420.0, 20.0, 50.0)


def with_jack(case: Callable[[FakeAxis, Plant], Awaitable[None]], *faults: Fault, plant: Plant | None = None) -> Plant:
    """Run `case` on a homed jack."""
    plant = plant or plant_of("ideal")

    async def main() -> None:
        jack = FakeAxis("jack", "mm", JACK, plant, FaultBook(faults))
        await jack.connect()
        await jack.home()
        await case(jack, plant)
        await jack.close()

    run_virtual(main())
    return plant


def now() -> float:
    return asyncio.get_running_loop().time()


def test_creep_starts_and_stops_softly() -> None:
    async def case(jack: FakeAxis, plant: Plant) -> None:
        moving = asyncio.create_task(jack.move_to(1.0, speed=0.2))
        await asyncio.sleep(0.01)
        assert plant.motion["jack"].now_at.accelerations.max() == pytest.approx(2.0)
        await moving

    with_jack(case)


def test_a_halt_runs_on_for_the_drives_delay_and_its_quick_stop() -> None:
    async def case(jack: FakeAxis, plant: Plant) -> None:
        moving = asyncio.create_task(jack.move_to(100.0, speed=10.0))
        await asyncio.sleep(2.0)
        here, began = plant.motion["jack"].position(now()), now()
        await jack.halt()
        assert now() - began == pytest.approx(0.005 + 10.0 / 200.0, abs=1e-6)
        stopped = (await jack.read()).position
        assert stopped - here == pytest.approx(10.0 * 0.005 + 100.0 / 400.0, abs=1e-6)
        with pytest.raises(Interrupted):
            await moving
        assert not (await jack.read()).brake_closed
        await asyncio.sleep(0.06)
        assert (await jack.read()).brake_closed

    with_jack(case)


@pytest.mark.parametrize(
    ("kind", "error"), [("following_error", DeviceFault), ("gone", NotConnected), ("hung", DeviceTimeout)]
)
def test_a_drive_in_trouble_on_its_way_stops_by_itself(kind: str, error: type[Exception]) -> None:
    async def case(jack: FakeAxis, plant: Plant) -> None:
        with pytest.raises(error):
            await jack.move_to(400.0, speed=10.0)
        assert now() == pytest.approx(10.0, abs=0.1)
        await asyncio.sleep(0.2)
        assert not plant.motion["jack"].moving(now())
        assert plant.motion["jack"].position(now()) < 100.0

    with_jack(case, Fault("jack", kind, at_s=10.0, duration_s=5.0))


def test_a_controller_that_drops_the_link_leaves_the_axis_standing() -> None:
    plant = plant_of("ideal")

    async def case(jack: FakeAxis, plant: Plant) -> None:
        moving = asyncio.create_task(jack.move_to(400.0, speed=10.0))
        await asyncio.sleep(1.0)
        await jack.close()
        with pytest.raises(Interrupted):
            await moving

    with_jack(case, plant=plant)
    assert plant.motion["jack"].now_at.target < 20.0


def test_what_the_drive_knows_outlives_the_controller() -> None:
    plant = plant_of("ideal")

    async def first(jack: FakeAxis, plant: Plant) -> None:
        await jack.move_to(30.0, speed=10.0)

    async def again() -> None:
        await asyncio.sleep(plant.now)
        jack = FakeAxis("jack", "mm", JACK, plant, FaultBook())
        await jack.connect()
        state = await jack.read()
        assert (state.homed, state.position) == (True, 30.0)

    with_jack(first, plant=plant)
    run_virtual(again())


def test_a_power_cut_with_a_late_brake_drops_the_load() -> None:
    async def case(jack: FakeAxis, plant: Plant) -> None:
        await jack.move_to(50.0, speed=10.0)
        await asyncio.sleep(21.0 - now())
        state = await jack.read()
        assert not state.enabled
        await asyncio.sleep(1.0)
        assert (await jack.read()).position == pytest.approx(50.0 - 0.5 * 9806.65 * 0.02**2)

    plant = with_jack(
        case, Fault("safety", "estop", at_s=20.0), plant=plant_of("ideal", overrides={"brake_late_s": 0.02})
    )
    assert plant.damages == ["the load was dropped"]


def test_backlash_and_scale_stand_between_encoder_and_truth() -> None:
    async def case(jack: FakeAxis, plant: Plant) -> None:
        state = await jack.move_to(300.0, speed=20.0)
        assert state.position == 300.0
        true = 400.0 - plant.gap_mm()
        expected = 300.0 * (1.0 + plant.cell.scale[2]) - 0.5 * plant.cell.backlash_mm[2]
        assert true == pytest.approx(expected, abs=1e-9)
        assert abs(true - 300.0) > 1e-4

    with_jack(case, plant=plant_of("nominal", overrides={"table_axis_tilt_x_deg": 0.0}))
