"""The axis backend against a drive on npm canopen, and the simulated drive against its master."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from hal.bus.hub import CanHub
from hal.errors import DeviceRefused, Interrupted
from hal.fake.faults import FaultBook
from tests.contract.backends import plant_of
from tests.contract.wire_axis import bus_of, wired
from tests.peers.peers import line_of, npm_script, running, said_by
from tests.peers.test_canopen import NUMBER, axis_on, beating

pytestmark = pytest.mark.peers


async def use(axis: Any) -> None:
    identity = await axis.connect()
    assert (identity.model, identity.firmware, identity.serial) == ("A drive on node.js", "6.2.1", "4712")
    assert not identity.simulated
    await axis.rearm()
    assert (await axis.home()).homed
    for target in (20.0, 5.0, 300.0):
        state = await axis.move_to(target, speed=20.0)
        assert (state.position, state.moving) == (target, False)
    move = asyncio.create_task(axis.move_to(0.0, speed=20.0))
    await asyncio.sleep(0.15)
    await axis.halt()
    with pytest.raises(Interrupted):
        await move
    assert (await axis.safe()).safe
    assert 0.0 < (await axis.read()).position < 300.0
    with pytest.raises(DeviceRefused, match="re-arm"):
        await axis.move_to(1.0, speed=1.0)
    await axis.rearm()


def test_the_backend_drives_it() -> None:
    async def main() -> None:
        hub = CanHub()
        await hub.start()
        bus = bus_of(hub)
        axis = axis_on(bus)
        try:
            async with running(*npm_script("drive.js"), str(hub.port), str(NUMBER)) as drive:
                assert await line_of(drive) == "ready"
                async with beating(bus):
                    await use(axis)
                    here = (await axis.read()).position
                    await axis.close()
                assert drive.stdin is not None
                drive.stdin.close()
                said = json.loads(await line_of(drive))
            assert said == {
                "starts": 5,
                "position": round(here * 10_000),
                "limits": [0, 4_200_000],
                "quickStop": 6,
                "consumer": 127 << 16 | 200,
            }
        finally:
            await axis.close()
            await hub.close()

    asyncio.run(main())


def test_its_master_is_obeyed_by_the_simulated_drive() -> None:
    async def main() -> None:
        async with wired("jack", plant_of("ideal"), FaultBook()) as wire:
            code, said = await said_by(*npm_script("master.js"), str(wire.hub.port), str(NUMBER))
        assert (code, said.strip()) == (0, "obeyed"), said

    asyncio.run(main())
