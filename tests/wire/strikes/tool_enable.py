"""Strikes on the line to the coupler that lets the guns turn: a trip takes it in spite of them."""

from __future__ import annotations

import asyncio
from pathlib import Path
from random import Random

from hal.guard.logic import Trip
from tests.contract.wire_guard import cleared
from tests.wire.strikes import Strike
from tests.wire.strikes.modbus import FATES, At
from tests.wire.test_tool_enable import WATCHDOG_S, Stand, falls, on_stand

DESK_S = 0.2
"""Loop time that a busy machine may add."""
SPOILT = {fault: fate for fault, fate in FATES["tcp"].items() if fault != "exception codes"}
"""What is refused is told to whoever asks, and nobody asks here: the guard only repeats itself."""


def struck(fault: str) -> Strike:
    """The guard trips while the line to the coupler is spoilt."""
    fate = SPOILT[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{fault} {seed}")

        async def case(stand: Stand) -> None:
            await asyncio.sleep(draw.uniform(0.0, 0.5))
            at = At(None, stand.coupler, stand.plant, "tcp", Path())
            lift = await fate.strike(at, draw)
            await asyncio.sleep(draw.choice((0.0, draw.uniform(0.0, 1.5))))
            stand.guard.process.sentry.latch(Trip("struck"))
            await falls(stand, WATCHDOG_S + DESK_S)
            await lift()
            await asyncio.sleep(2.5)
            assert not stand.plant.tools_enabled, "it came back while the trip is latched"
            await cleared(stand.guard.link)
            await stand.enable.rearm()
            assert stand.plant.tools_enabled, "re-armed, it does not come back"

        on_stand(case)

    return strike


STRIKES: dict[str, Strike] = {fault: struck(fault) for fault in SPOILT}
