"""Who lets the guns turn: asked for again and again, off at once."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from hal.clock import run_virtual
from hal.errors import DeviceTimeout, NotConnected, SafetyOpen
from hal.guard.enable import EnableKeeper
from tests.hal.small import SmallToolEnable


class Kept:
    """A keeper of a small output; `refused` is what keeps the guns from turning."""

    def __init__(self, watchdog_s: float) -> None:
        self.output = SmallToolEnable(enabled=False)
        self.refused = ""
        self.keeper = EnableKeeper(self.output, lambda: self.refused, watchdog_s)

    def trip(self, reason: str) -> None:
        """Trip, or clear the trip, and say so."""
        self.refused = reason
        self.keeper.look()


def kept(case: Callable[[Kept], Awaitable[None]], *, watchdog_s: float = 1.0) -> None:
    """Run `case` on a connected keeper; no task may be left."""

    async def main() -> None:
        stand = Kept(watchdog_s)
        await stand.keeper.connect()
        await case(stand)
        await stand.keeper.close()
        assert not stand.output.enabled
        assert len(asyncio.all_tasks()) == 1

    run_virtual(main())


def test_it_is_off_until_re_armed_and_then_asked_for_in_time() -> None:
    async def case(stand: Kept) -> None:
        await asyncio.sleep(3.0)
        assert not stand.output.enabled
        assert (await stand.keeper.read()).reason == "not re-armed"
        await stand.keeper.rearm()
        assert stand.output.enabled
        before = stand.output.asked
        await asyncio.sleep(2.0)
        assert stand.output.asked - before >= 8
        assert (await stand.keeper.read()).enabled

    kept(case)


def test_without_a_watchdog_nothing_is_asked_while_nothing_happens() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        await asyncio.sleep(0.1)
        before = stand.output.asked
        await asyncio.sleep(1e5)
        assert stand.output.asked == before
        stand.trip("tripped")
        await asyncio.sleep(1e-3)
        assert not stand.output.enabled
        stand.trip("")
        await asyncio.sleep(1e-3)
        assert stand.output.enabled

    kept(case, watchdog_s=0.0)


def test_a_trip_takes_it_at_once_and_clearing_it_gives_it_back() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        stand.trip("tripped")
        state = await stand.keeper.read()
        assert (state.enabled, state.reason) == (False, "tripped")
        await asyncio.sleep(1e-3)
        assert not stand.output.enabled
        await stand.keeper.rearm()
        await asyncio.sleep(5.0)
        assert not stand.output.enabled, "tripped still"
        stand.trip("")
        await asyncio.sleep(1e-3)
        assert stand.output.enabled

    kept(case)


def test_halted_it_stays_off_whatever_becomes_of_trips() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        await stand.keeper.halt()
        assert not stand.output.enabled
        stand.trip("tripped")
        stand.trip("")
        await asyncio.sleep(5.0)
        assert not stand.output.enabled
        assert (await stand.keeper.read()).reason == "halted"
        await stand.keeper.rearm()
        assert stand.output.enabled

    kept(case)


def test_a_guard_that_dies_without_a_word_is_noticed_within_the_watchdog() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        stand.refused = "the guard has died"
        await asyncio.sleep(0.3)
        assert not stand.output.enabled
        assert (await stand.keeper.read()).reason == "the guard has died"

    kept(case)


def test_an_output_that_fell_by_itself_is_not_set_again() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        stand.output.enabled, stand.output.fallen = False, "the coupler dropped it"
        await asyncio.sleep(0.3)
        assert (await stand.keeper.read()).reason == "the coupler dropped it"
        stand.output.fallen = ""
        await asyncio.sleep(5.0)
        assert not stand.output.enabled

    kept(case)


def test_a_late_answer_is_asked_for_again_and_an_off_that_was_lost_is_said_again() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        stand.output.error = DeviceTimeout("late", device="tool_enable")
        await asyncio.sleep(0.5)
        assert (await stand.keeper.read()).enabled
        stand.trip("tripped")
        await asyncio.sleep(0.5)
        assert stand.output.enabled, "nobody could tell it"
        stand.output.error = None
        await asyncio.sleep(0.2)
        assert not stand.output.enabled

    kept(case)


@pytest.mark.parametrize("error", [SafetyOpen("no power"), NotConnected("no link")])
def test_an_output_that_cannot_be_set_is_told_by_the_re_arming(error: Exception) -> None:
    async def case(stand: Kept) -> None:
        stand.output.error = error
        with pytest.raises(type(error)):
            await stand.keeper.rearm()
        stand.output.error = None
        await asyncio.sleep(1.0)
        assert not stand.output.enabled

    kept(case)


def test_a_coupler_that_is_gone_is_asked_now_and_then() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        asked = 0

        async def gone() -> None:
            nonlocal asked
            asked += 1
            assert asked < 100, "asked without a pause"
            raise NotConnected("no link", device="tool_enable")

        exchange, stand.output.exchange = stand.output.exchange, gone  # type: ignore[method-assign]
        await asyncio.sleep(2.0)
        assert 5 <= asked <= 25
        assert not (await stand.keeper.read()).enabled
        stand.output.exchange = exchange  # type: ignore[method-assign]
        await asyncio.sleep(0.2)
        assert not stand.output.enabled, "off as soon as it can be said"

    kept(case)


def test_a_halt_while_it_is_being_asked_for_is_the_last_word() -> None:
    async def case(stand: Kept) -> None:
        await stand.keeper.rearm()
        slow = stand.output.exchange

        async def late() -> None:
            await asyncio.sleep(0.05)
            await slow()

        stand.output.exchange = late  # type: ignore[method-assign]
        for _ in range(40):
            await asyncio.sleep(0.01)
            await stand.keeper.halt()
            await asyncio.sleep(0.3)
            assert not stand.output.enabled
            await stand.keeper.rearm()

    kept(case)
