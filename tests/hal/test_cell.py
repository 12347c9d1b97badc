"""The cell as a whole: connecting, stopping, re-arming, closing."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Coroutine
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hal.cell import CellFailure
from hal.clock import run_virtual
from hal.entries import Devices
from hal.errors import CellError, Interrupted, NotConnected, SafetyOpen
from hal.interfaces import GuardLimits, SafeState
from tests.hal.small import GOOD_SAFETY
from tests.hal.small_cell import NAMES, SmallCell

DEADLINE_S = 0.5
GUARD = GuardLimits("insert", tare_n=1000.0, trip_n=5.0, low_n=-50.0, stale_ms=50.0, block=10)


def run(main: Coroutine[Any, Any, None]) -> None:
    async def whole() -> None:
        await main
        assert len(asyncio.all_tasks()) == 1, "a task was left"

    run_virtual(whole())


def test_connecting_names_every_device_that_failed() -> None:
    async def main() -> None:
        small = SmallCell()
        small.bare["heater"].error = NotConnected("no link", device="heater")
        small.bare["pyrometer"].error = NotConnected("no link", device="pyrometer")
        small.bare["gun_b"].hang = True
        small.bare["scanner"].error = RuntimeError("a bug")
        with pytest.raises(CellFailure) as caught:
            await small.cell.connect()
        assert set(caught.value.failures) == {"heater", "pyrometer", "gun_b", "scanner"}
        for text in (
            "4 of 26 devices did not connect",
            "pyrometer, heater: no link",
            "gun_b: did not connect within 5 s",
            "a bug",
        ):
            assert text in str(caught.value)
        assert asyncio.get_running_loop().time() == pytest.approx(5.0)

    run(main())


def test_connecting_gives_every_identity() -> None:
    async def main() -> None:
        small = SmallCell()
        identities = await small.cell.connect()
        assert set(identities) == set(Devices.model_fields)
        assert all(identity.simulated for identity in identities.values())
        await small.cell.close()
        assert all(device.closed for device in small.bare.values())

    run(main())


def test_everything_is_halted_and_read_back() -> None:
    async def main() -> None:
        small = SmallCell()
        move = asyncio.create_task(small.cell.jack.move_to(300.0, speed=1.0))
        await asyncio.sleep(1.0)
        report = await small.cell.make_safe(DEADLINE_S)
        assert report.safe
        assert report.unsafe == {}
        assert [name for name, _ in report.devices] == list(Devices.model_fields)
        assert all(device.halts >= 1 for device in small.bare.values())
        with pytest.raises(Interrupted):
            await move
        with pytest.raises(SafetyOpen, match="until re-armed"):
            await small.cell.jack.move_to(1.0, speed=1.0)

    run(main())


def test_a_hung_device_is_reported_and_holds_up_nobody() -> None:
    async def main() -> None:
        small = SmallCell()
        small.bare["heater"].hang = True
        small.bare["gun_a"].error = NotConnected("no link", device="gun_a")
        loop = asyncio.get_running_loop()
        began = loop.time()
        report = await small.cell.make_safe(DEADLINE_S)
        assert loop.time() - began <= DEADLINE_S
        assert not report.safe
        assert set(report.unsafe) == {"heater", "gun_a"}
        assert "no answer" in report.unsafe["heater"]
        assert report.unsafe["gun_a"] == "no link; halt: gun_a: no link"

    run(main())


def test_safe_is_read_back_until_it_is_true() -> None:
    async def main() -> None:
        small = SmallCell()
        answers = iter([SafeState(False, "brake closing")] * 4)

        async def safe() -> SafeState:
            return next(answers, SafeState(True, "brake closed"))

        small.bare["gun_b"].safe = safe  # type: ignore[method-assign]
        report = await small.cell.make_safe(DEADLINE_S)
        assert report.safe
        assert report.took_s == pytest.approx(0.04)

    run(main())


def test_a_command_on_its_way_to_an_axis_never_starts_it() -> None:
    async def main() -> None:
        small = SmallCell()
        jack = small.axes["jack"]
        jack.delay_s = 0.1
        move = asyncio.create_task(small.cell.jack.move_to(300.0, speed=1.0))
        await asyncio.sleep(0.05)
        assert (await small.cell.make_safe(DEADLINE_S)).safe
        await asyncio.sleep(1.0)
        assert jack.starts == 0
        with pytest.raises(Interrupted, match="the cell was stopped"):
            await move

    run(main())


def test_a_cancelled_caller_does_not_keep_the_cell_from_getting_safe() -> None:
    async def main() -> None:
        small = SmallCell()
        small.bare["scanner"].hang = True
        stop = asyncio.create_task(small.cell.make_safe(DEADLINE_S))
        await asyncio.sleep(0.01)
        stop.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await stop
        await asyncio.sleep(DEADLINE_S)
        assert all(device.halts >= 1 for device in small.bare.values())

    run(main())


def test_stopping_twice_at_once_is_harmless() -> None:
    async def main() -> None:
        small = SmallCell()
        first, second = await asyncio.gather(small.cell.make_safe(DEADLINE_S), small.cell.make_safe(DEADLINE_S))
        assert first.safe
        assert second.safe
        assert (await small.cell.make_safe(DEADLINE_S)).safe

    run(main())


def test_rearming_needs_closed_safety_inputs_and_every_device() -> None:
    async def main() -> None:
        small = SmallCell()
        await small.cell.make_safe(DEADLINE_S)
        small.safety.state = replace(GOOD_SAFETY, guards_closed=False)
        with pytest.raises(SafetyOpen, match="guard doors open"):
            await small.cell.rearm()
        small.safety.state = GOOD_SAFETY
        small.bare["gun_a"].error = NotConnected("no link", device="gun_a")
        with pytest.raises(CellFailure, match="1 of 26 devices did not re-arm: gun_a"):
            await small.cell.rearm()
        assert small.latch.closed
        small.bare["gun_a"].error = None
        await small.cell.rearm()
        assert not small.latch.closed
        assert (await small.cell.jack.move_to(10.0, speed=10.0)).position == 10.0

    run(main())


def test_rearming_clears_the_guard_as_well() -> None:
    async def main() -> None:
        small = SmallCell()
        small.force.script = {5: 2000.0}
        await small.cell.guard.arm(GUARD)
        assert small.cell.guard.state().tripped
        await small.cell.make_safe(DEADLINE_S)
        await small.cell.rearm()
        state = small.cell.guard.state()
        assert not state.tripped
        assert not state.armed

    run(main())


def test_an_open_safety_input_is_told() -> None:
    async def main() -> None:
        small = SmallCell()
        loop = asyncio.get_running_loop()
        loop.call_later(2.0, lambda: setattr(small.safety, "state", replace(GOOD_SAFETY, estop_released=False)))
        assert await small.cell.until_unsafe() == "safety: emergency stop open"
        assert 2.0 <= loop.time() <= 2.3
        small.safety.error = NotConnected("no link", device="safety")
        assert "counts as tripped" in await small.cell.until_unsafe()

    run(main())


@pytest.mark.parametrize("seed", range(60))
def test_safe_from_any_instant_with_any_device_hung(seed: int) -> None:
    async def busy(small: SmallCell, rng: np.random.Generator) -> None:
        while True:
            name = NAMES[int(rng.integers(len(NAMES)))]
            with contextlib.suppress(CellError):
                await getattr(small.cell, name).move_to(float(rng.uniform(-30, 30)), speed=float(rng.uniform(5, 50)))
            await asyncio.sleep(0.01)

    async def main() -> None:
        rng = np.random.default_rng(seed)
        small = SmallCell()
        for axis in small.axes.values():
            axis.delay_s = float(rng.choice([0.0, 0.02]))
        await small.cell.guard.arm(GUARD)
        work = [asyncio.create_task(busy(small, rng)) for _ in range(3)]
        await asyncio.sleep(float(rng.uniform(0.0, 3.0)))
        hung = str(rng.choice(sorted(small.bare))) if rng.random() < 0.5 else ""
        if hung:
            small.bare[hung].hang = True
        loop = asyncio.get_running_loop()
        began = loop.time()
        report = await small.cell.make_safe(DEADLINE_S)
        assert loop.time() - began <= DEADLINE_S
        assert set(report.unsafe) == ({hung} if hung else set())
        assert not any(axis.moving for name, axis in small.axes.items() if name != hung)
        for task in work:
            task.cancel()
        await asyncio.wait(work, timeout=1.0)
        assert all(task.done() for task in work)
        starts = [axis.starts for axis in small.axes.values()]
        await asyncio.sleep(2.0)
        assert starts == [axis.starts for axis in small.axes.values()]
        await small.cell.close()

    run(main())
