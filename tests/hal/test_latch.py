"""The latch between commands and metal."""

from __future__ import annotations

import asyncio

import pytest

from hal.clock import run_virtual
from hal.errors import GuardTripped, Interrupted, SafetyOpen
from hal.latch import Latch


async def value() -> int:
    await asyncio.sleep(1.0)
    return 7


def test_each_holder_opens_its_own_reason_only() -> None:
    latch = Latch()
    assert latch.refusal("jack") is None
    latch.close("safe stop", "asked")
    latch.close("guard", "over force")
    latch.close("guard", "later reason")
    assert isinstance(latch.refusal("jack"), GuardTripped)
    assert "over force" in str(latch.refusal("jack"))
    latch.open("guard")
    assert isinstance(latch.refusal("jack"), SafetyOpen)
    latch.open("guard")
    assert latch.closed
    latch.open("safe stop")
    assert not latch.closed


def test_a_command_in_flight_is_known_until_it_ends() -> None:
    async def main() -> None:
        latch = Latch()
        done = latch.start("jack", value)
        ended = latch.start("gun_a", value)
        latch.close("safe stop", "asked")
        with pytest.raises(SafetyOpen):
            latch.start("jack", value)
        assert latch.end("gun_a", "gun_b") == {"gun_a"}
        await asyncio.wait({done, ended})
        assert latch.result("jack", done) == 7
        with pytest.raises(Interrupted, match="asked"):
            latch.result("gun_a", ended)
        assert latch.end() == set()

    run_virtual(main())
