"""The axis backend against the LocalNode of PyPI canopen, and the simulated drive against its master."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from hal.bus.can import CanBus
from hal.bus.hub import CanHub
from hal.entries import CanAxisEntry
from hal.errors import DeviceRefused, Interrupted
from hal.fake.faults import FaultBook
from hal.real.axes import CanAxis
from tests.contract.backends import plant_of
from tests.contract.wire_axis import beat, bus_of, entry_of, wired
from tests.peers.peers import met_package

pytestmark = pytest.mark.peers
NUMBER = 3


@contextlib.asynccontextmanager
async def beating(bus: CanBus) -> AsyncIterator[None]:
    beats = asyncio.create_task(beat(bus))
    try:
        yield
    finally:
        beats.cancel()
        await asyncio.wait({beats})


def connected(port: int) -> Any:
    import canopen

    met_package("canopen")
    network = canopen.Network()
    network.connect(
        interface="slcan",
        channel=f"socket://127.0.0.1:{port}",
        bitrate=1_000_000,
        sleep_after_open=0.0,
        ignore_config=True,
    )
    return network


def axis_on(bus: CanBus, **changes: object) -> CanAxis:
    entry = entry_of("jack", NUMBER)
    return CanAxis("jack", "mm", CanAxisEntry.model_validate(entry.model_dump() | changes), bus)


async def use(axis: CanAxis, drive: Any) -> None:
    identity = await axis.connect()
    assert (identity.model, identity.firmware, identity.serial) == ("A drive with a long name", "7.1", "4711")
    assert not identity.simulated
    await axis.rearm()
    assert (await axis.home()).homed
    for target in (20.0, 5.0, 300.0):
        starts = drive.starts
        state = await axis.move_to(target, speed=20.0)
        assert (state.position, state.moving) == (target, False)
        assert drive.starts == starts + 1
    move = asyncio.create_task(axis.move_to(0.0, speed=20.0))
    await asyncio.sleep(0.15)
    await axis.halt()
    with pytest.raises(Interrupted):
        await move
    assert (await axis.safe()).safe
    here = (await axis.read()).position
    assert 0.0 < here < 300.0
    with pytest.raises(DeviceRefused, match="re-arm"):
        await axis.move_to(1.0, speed=1.0)
    await axis.rearm()
    assert (await axis.read()).position == here


def test_the_backend_drives_the_local_node() -> None:
    from tests.peers.canopen_drive import PeerDrive

    async def main() -> None:
        hub = CanHub()
        await hub.start()
        bus = bus_of(hub)
        network = await asyncio.to_thread(connected, hub.port)
        axis = axis_on(bus)
        try:
            drive = PeerDrive(network, NUMBER)
            async with beating(bus):
                await use(axis, drive)
                set_ = drive.node.data_store
                assert set_[0x605A][0] == b"\x06\x00"
                assert set_[0x1016][1] == (127 << 16 | 200).to_bytes(4, "little")
                assert set_[0x607D][2] == (4_200_000).to_bytes(4, "little")
                await axis.close()
                other = axis_on(bus, gear_motor=2)
                with pytest.raises(DeviceRefused, match="gear ratio"):
                    await other.connect()
        finally:
            await axis.close()
            drive.node.nmt.stop_heartbeat()
            await asyncio.to_thread(network.disconnect)
            await hub.close()

    asyncio.run(main())


def master(port: int) -> None:
    """The session of a canopen master with the simulated drive, in a thread."""
    import canopen

    from tests.peers.canopen_drive import dictionary

    with connected(port) as network:
        node = canopen.RemoteNode(NUMBER, dictionary(NUMBER))
        network.add_node(node)
        assert node.sdo[0x1000].raw == 0x00020192
        assert node.sdo[0x1008].raw == "servo drive"
        with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
            node.sdo.upload(0x5FFF, 0)
        with pytest.raises(canopen.SdoAbortedError, match="0x06070010"):
            node.sdo.download(0x6040, 0, bytes(4))
        node.sdo[0x1017].raw = 20
        assert node.nmt.wait_for_heartbeat(5.0) == "PRE-OPERATIONAL"
        node.tpdo.read()
        node.tpdo[1].clear()
        node.tpdo[1].add_variable(0x6041)
        node.tpdo[1].add_variable(0x6061)
        node.tpdo[1].enabled = True
        node.tpdo[1].save()
        node.nmt.state = "OPERATIONAL"
        assert node.nmt.wait_for_heartbeat(5.0) == "OPERATIONAL"
        node.sdo[0x6083].raw = node.sdo[0x6085].raw = 1_000_000
        node.sdo[0x607A].raw = 10_000
        node.sdo[0x6081].raw = 100_000
        node.sdo[0x6040].raw = 0x0F
        node.sdo[0x6040].raw = 0x1F
        assert node.sdo[0x6041].raw & 0x1400 == 0x1000
        node.sdo[0x6040].raw = 0x0F
        for _ in range(100):
            node.tpdo[1].wait_for_reception(5.0)
            if node.tpdo[1][0x6041].raw & 0x1400 == 0x0400:
                break
        assert node.sdo[0x6064].raw == 10_000
        node.sdo[0x6040].raw = 0x02
        assert node.sdo[0x6041].raw & 0x6F == 0x07


def test_the_simulated_drive_obeys_a_canopen_master() -> None:
    async def main() -> None:
        async with wired("jack", plant_of("ideal"), FaultBook()) as wire:
            await asyncio.to_thread(master, wire.hub.port)

    asyncio.run(main())
