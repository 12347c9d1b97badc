"""The Modbus simulators against mbpoll, over TCP and RTU. Registers are named by number, as mbpoll's user would."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator
from typing import Any

import pytest

from hal.fake.faults import Fault, FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus import SimulatedModbus
from tests.contract.backends import plant_of
from tests.contract.fakes import fake_device
from tests.contract.wire_modbus import UNIT
from tests.peers.peers import met_debian, program, said_by

pytestmark = pytest.mark.peers
FRAMINGS = pytest.mark.parametrize("framing", ["tcp", "rtu"])
HEATER, GAP, CHUCK = 0x100, 0x200, 0x300
VALUE = re.compile(r"^\[(\d+)\]:\s+(\S+)", re.MULTILINE)


class Poll:
    """mbpoll on one server; addresses count from 0."""

    def __init__(self, *where: str) -> None:
        met_debian("mbpoll")
        self._where = where

    async def _said(self, *options: str, values: tuple[str, ...] = (), unit: int = UNIT) -> tuple[int, str]:
        *link, at = self._where
        command = (program("mbpoll"), *link, "-a", str(unit), "-0", "-1", "-o", "2", *options, at, *values)
        return await said_by(*command)

    async def read(self, kind: str, at: int, count: int, *options: str) -> list[str]:
        """`count` values from `at` on, as they are printed."""
        code, said = await self._said("-t", kind, "-r", str(at), "-c", str(count), *options)
        assert code == 0, said
        return [value for _, value in VALUE.findall(said)]

    async def write(self, kind: str, at: int, *values: str, big: bool = False) -> None:
        """Write; it must be acknowledged."""
        code, said = await self._said("-t", kind, "-r", str(at), *(("-B",) if big else ()), values=values)
        assert code == 0, said
        assert re.search(r"Written \d+ reference", said), said

    async def refused(self, *options: str, values: tuple[str, ...] = (), unit: int = UNIT) -> str:
        """What it says to a request that must fail."""
        _, said = await self._said(*options, values=values, unit=unit)
        assert "failed" in said, said
        return said


@contextlib.asynccontextmanager
async def polled(framing: Any, *faults: Fault) -> AsyncIterator[tuple[Poll, Plant, SimulatedModbus]]:
    """A unit with a thermocouple, the heater, a gap probe and the chuck."""
    plant, book = plant_of("ideal"), FaultBook(faults)
    names = {0: "spigot_tc_1", HEATER: "heater", GAP: "gap_probe_1", CHUCK: "chuck"}
    units = {UNIT: {base: fake_device(name, plant, book) for base, name in names.items()}}
    simulated = SimulatedModbus(units, plant, book, framing)
    try:
        if framing == "tcp":
            yield Poll("-m", "tcp", "-p", str(await simulated.start()), "127.0.0.1"), plant, simulated
        else:
            yield Poll("-m", "rtu", "-b", "19200", "-P", "none", await simulated.start_pty()), plant, simulated
    finally:
        await simulated.close()


@FRAMINGS
def test_it_reads_what_the_simulators_measure(framing: str) -> None:
    async def main() -> None:
        async with polled(framing) as (poll, _, simulated):
            (said,) = await poll.read("3:float", 0, 1, "-B")
            reading = await simulated.part(UNIT).fake.read()
            assert float(said) == pytest.approx(reading.value, abs=0.5)
            assert (await poll.read("3", 2, 1)) == ["0"]
            gap_um10 = int((await poll.read("3", GAP, 1))[0])
            gap = await simulated.part(UNIT, GAP).fake.read()
            assert gap_um10 / 10_000 == pytest.approx(gap.value, abs=0.01)
            letters = await poll.read("3:hex", 0x1000, 4)
            assert bytes.fromhex("".join(word.removeprefix("0x") for word in letters)) == b"cellctl\0"
            first, second = [int((await poll.read("4", 3, 1))[0]) for _ in range(2)]
            assert second > first, "holding and input registers are one table, each look is a conversion"

    asyncio.run(main())


@FRAMINGS
def test_it_heats_and_switches_off(framing: str) -> None:
    async def main() -> None:
        async with polled(framing) as (poll, _, simulated):
            await poll.write("4:float", HEATER + 16, "120.5", "30", "1500", big=True)
            assert (await poll.read("4:float", HEATER + 16, 3, "-B")) == ["120.5", "30", "1500"]
            await poll.write("4", HEATER + 23, "5000")
            await poll.write("4", HEATER + 22, "1")
            assert (await poll.read("3", HEATER + 4, 1)) == ["7"], "on, watchdog armed, supplied"
            state = await simulated.part(UNIT, HEATER).fake.read()
            assert state.on
            await poll.write("4", HEATER + 22, "0")
            assert (await poll.read("3", HEATER + 4, 1)) == ["6"]

    asyncio.run(main())


@FRAMINGS
def test_it_clamps(framing: str) -> None:
    async def main() -> None:
        async with polled(framing) as (poll, plant, _):
            before = plant.chuck_clamped
            await poll.write("4", CHUCK, "2" if before else "1")
            async with asyncio.timeout(30.0):
                while plant.chuck_clamped is before:
                    await poll.read("3", CHUCK + 2, 1)
            await poll.write("4", CHUCK, "0")

    asyncio.run(main())


@FRAMINGS
def test_it_is_refused_what_is_not_there(framing: str) -> None:
    async def main() -> None:
        async with polled(framing) as (poll, _, _):
            assert "Illegal data address" in await poll.refused("-t", "3", "-r", "80", "-c", "2")
            assert "Illegal data address" in await poll.refused("-t", "4", "-r", "0", values=("7",))
            assert "Illegal function" in await poll.refused("-t", "0", "-r", "0")
            assert "Illegal data value" in await poll.refused("-t", "4", "-r", str(CHUCK), values=("3",))
            said = await poll.refused("-t", "3", "-r", "0", unit=UNIT + 1)
            assert ("target device failed to respond" if framing == "tcp" else "timed out") in said.lower()
            assert len(await poll.read("3", 0, 4)) == 4, "and goes on"

    asyncio.run(main())


@FRAMINGS
def test_an_open_circuit_is_a_status_bit(framing: str) -> None:
    async def main() -> None:
        async with polled(framing, Fault("spigot_tc_1", "nan")) as (poll, _, _):
            assert (await poll.read("3", 2, 1)) == ["1"]

    asyncio.run(main())
