"""What passes on a bus is in the file, in order, with its direction; the devices do not notice."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path

import pytest

from cellctl.commissioning.bench import opened
from cellctl.commissioning.capture import Order, capture
from cellctl.commissioning.survey import survey
from hal.capture import Direction, Record, read_capture
from hal.codec.cia301 import HEARTBEAT, SDO_REPLY, SDO_REQUEST
from hal.codec.force_line import decode, split
from hal.codec.modbus import take_request
from hal.codec.open_protocol import Framer
from hal.config import CellConfig
from hal.errors import ConfigError, NotConnected
from hal.fake.wire.stand import Stand
from hal.tap import bus_named, tapped
from tests.commissioning.cells import on_wires
from tests.journeys.twin_runs import RECIPE


async def recorded(config: CellConfig, word: str, file: Path, listen: str = "") -> tuple[Record, ...]:
    """A recording of the bus of `word` while its devices are asked from here."""
    order = Order(bus_named(config, word), file, listen, ask=True, seconds=20.0)
    counts = await capture(config, RECIPE, order, asyncio.Event(), lambda tap: None)
    header, records = read_capture(file)
    assert (header.cell, header.bus) == (config.cell.name, order.bus.name)
    assert word in header.devices
    assert [record.time_s for record in records] == sorted(record.time_s for record in records)
    for way in ("out", "in"):
        assert counts[way] == sum(len(record.data) for record in records if record.direction == way) > 0
    return records


def said(records: tuple[Record, ...], way: Direction) -> bytes:
    return b"".join(record.data for record in records if record.direction == way)


def test_open_protocol(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        records = await recorded(config, "gun_b", tmp_path / "gun.jsonl")
        out, came = (list(Framer().feed(said(records, way))) for way in ("out", "in"))
        assert [message.mid for message in out][:2] == [1, 14]
        assert [message.mid for message in came][:2] == [2, 5]
        assert [record.event for record in records if record.event] == ["opened", "closed by the controller"]

    on_wires(tmp_path, case)


def test_modbus_tcp(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        records = await recorded(config, "chuck", tmp_path / "modbus.jsonl")
        units, rest = set(), said(records, "out")
        while rest:
            request, used = take_request(rest, "tcp")
            assert request is not None
            units.add(request.unit)
            rest = rest[used:]
        assert units == {1, 2, 3, 4, 5, 6, 7, 8, 9}

    on_wires(tmp_path, case)


def test_modbus_rtu(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        records = await recorded(config, "pyrometer", tmp_path / "rtu.jsonl", str(tmp_path / "tap"))
        units, rest = set(), said(records, "out")
        while rest:
            request, used = take_request(rest, "rtu")
            assert request is not None
            units.add(request.unit)
            rest = rest[used:]
        assert units == {1, 2, 3, 4}
        assert not (tmp_path / "tap").exists()

    on_wires(tmp_path, case)


def test_a_serial_stream(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        records = await recorded(config, "gun_force_a", tmp_path / "force.jsonl")
        lines, rest = split(said(records, "in"))
        assert len([decode(line) for line in lines]) > 20
        assert rest == b""
        assert records[1].data == b"? 1 stop*1AAC\n"

    on_wires(tmp_path, case)


def test_can_is_listened_to_beside_a_controller(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        heard: list[Record] = []
        async with tapped(config, bus_named(config, "can"), heard.append), opened(config, RECIPE) as cell:
            await survey(cell, config, ["stage_x"])
            await asyncio.sleep(1.0)
        ways: Mapping[int | None, Direction] = {record.can_id: record.direction for record in heard}
        assert ways[SDO_REQUEST + 1] == ways[HEARTBEAT + 127] == ways[0] == "out"
        assert ways[SDO_REPLY + 1] == ways[HEARTBEAT + 1] == "in"
        asked = [record for record in heard if record.can_id == SDO_REQUEST + 1]
        answered = [record for record in heard if record.can_id == SDO_REPLY + 1]
        assert len(asked) == len(answered) > 30

    on_wires(tmp_path, case)


def test_a_device_that_is_not_there_is_seen_by_its_controller(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        await stand.guns["gun_a"].close()
        heard: list[Record] = []
        async with tapped(config, bus_named(config, "gun_a"), heard.append) as tap, opened(tap.config, RECIPE) as cell:
            (found,) = await survey(cell, tap.config, ["gun_a"])
            assert found.error
        assert [record.event.partition(":")[0] for record in heard] == ["lost"]
        stand.forces["gun_force_a"].unplug()
        with pytest.raises(NotConnected, match="gun_force_a"):
            async with tapped(config, bus_named(config, "gun_force_a"), heard.append):
                pass

    on_wires(tmp_path, case)


def test_a_link_that_is_lost_comes_back_through_the_relay(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        heard: list[Record] = []
        async with tapped(config, bus_named(config, "heater"), heard.append) as tap, opened(tap.config, RECIPE) as cell:
            assert (await survey(cell, tap.config, ["heater"]))[0].error == ""
            (server,) = [one.server for one in stand.modbus if one.server.port == config.entries["heater"].port]
            await server.close()
            assert (await survey(cell, tap.config, ["heater"]))[0].error
            await server.start()
            await asyncio.sleep(3.0)
            assert (await survey(cell, tap.config, ["heater"]))[0].error == ""
        links = {record.link for record in heard if record.event == "opened"}
        assert len(links) >= 2
        assert "closed by the device" in {record.event for record in heard}

    on_wires(tmp_path, case)


def test_a_bus_goes_by_the_name_of_any_device_on_it(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        assert bus_named(config, "can") == bus_named(config, "jack")
        assert bus_named(config, "rotor_tc") == bus_named(config, "pyrometer")
        assert bus_named(config, "gun_a") != bus_named(config, "gun_b")
        with pytest.raises(ConfigError, match=r"nowhere.*on no bus of this cell.*can"):
            bus_named(config, "nowhere")
        with pytest.raises(ConfigError, match="scanner"):
            bus_named(config, "scanner")

    on_wires(tmp_path, case)
