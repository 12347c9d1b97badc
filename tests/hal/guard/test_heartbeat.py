"""The drives' heartbeat goes on while the guard lives, and no longer."""

from __future__ import annotations

import asyncio

from hal.clock import run_virtual
from hal.guard.heartbeat import Heartbeat


def test_it_beats_while_the_guard_lives_and_ends_when_it_is_closed() -> None:
    async def main() -> None:
        sent: list[float] = []
        loop, alive = asyncio.get_running_loop(), [True]
        heartbeat = Heartbeat(lambda: sent.append(loop.time()), lambda: alive[0], 0.1)
        heartbeat.start()
        heartbeat.start()
        await asyncio.sleep(0.95)
        assert len(sent) == 10
        alive[0] = False
        await asyncio.sleep(1.0)
        assert len(sent) == 10
        alive[0] = True
        await asyncio.sleep(0.1)
        assert len(sent) == 11
        await heartbeat.close()
        await asyncio.sleep(1.0)
        assert len(sent) == 11
        await heartbeat.close()

    run_virtual(main())
