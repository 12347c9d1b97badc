"""Coils on a Modbus line: what is read and set, and a setting that is called off right before it is sent."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine
from typing import Any

import pytest

from hal.bus.modbus import Line, Link
from hal.bus.modbus_server import ModbusServer, WireFault
from hal.codec.modbus import READ_COILS, READ_HOLDING, WRITE_COIL, Framing, Request
from hal.errors import DeviceFault, DeviceTimeout, Interrupted, UnknownOutcome
from tests.contract.backends import quickened

ON_BOTH = pytest.mark.parametrize("framing", ["tcp", "rtu"])


def run(main: Coroutine[Any, Any, None]) -> None:
    quickened(main, 200.0)


class Coils:
    """Forty coils, and holding registers that say their own address."""

    def __init__(self) -> None:
        self.on = [False] * 40
        self.writes = 0

    async def answer(self, request: Request) -> tuple[int, ...]:
        at, end = request.address, request.address + request.count
        if request.function == WRITE_COIL:
            self.writes += 1
            self.on[at] = bool(request.words[0])
            return ()
        return tuple(range(at, end)) if request.function == READ_HOLDING else tuple(map(int, self.on[at:end]))


@contextlib.asynccontextmanager
async def lined(framing: Framing) -> AsyncIterator[tuple[Line, ModbusServer, Coils]]:
    coils = Coils()
    server = ModbusServer(coils, framing)
    await server.start()
    line = Line(Link(port=server.port, framing=framing))
    await line.open("test")
    try:
        yield line, server, coils
    finally:
        await line.close("test")
        await server.close()


@ON_BOTH
def test_coils_are_set_and_read(framing: Framing) -> None:
    async def main() -> None:
        async with lined(framing) as (line, _, coils):
            for at in (3, 12, 34):
                await line.set_coil(1, at, True, device="gun")
            await line.set_coil(1, 12, False, device="gun")
            read = await line.coils(1, 2, 35, device="gun")
            assert [at for at, on in enumerate(read, 2) if on] == [3, 34]
            assert await line.read(1, 7, 3, device="gun", holding=True) == (7, 8, 9)
            assert coils.writes == 4

    run(main())


@ON_BOTH
def test_a_coil_is_set_once_whatever_becomes_of_the_answer(framing: Framing) -> None:
    async def main() -> None:
        async with lined(framing) as (line, server, coils):
            for kind, error in (("silent", DeviceTimeout), ("late", DeviceTimeout), ("drop", UnknownOutcome)):
                before = coils.writes
                server.faults.append(WireFault(kind, 1.8, 1, WRITE_COIL))  # type: ignore[arg-type]
                with pytest.raises(error, match="coil 3"):
                    await line.set_coil(1, 3, True, device="gun")
                assert coils.writes == before + 1
                assert (await line.coils(1, 3, 1, device="gun")) == (True,)
            server.faults.append(WireFault("short", 0.0, 1, READ_COILS))
            with pytest.raises(DeviceFault, match="8 coils came"):
                await line.coils(1, 0, 9, device="gun")

    run(main())


@ON_BOTH
def test_a_long_answer_that_comes_twice_is_an_answer(framing: Framing) -> None:
    async def main() -> None:
        async with lined(framing) as (line, server, _):
            server.faults.append(WireFault("duplicate", times=3))
            for count in (120, 67, 120, 3):
                read = await line.read(1, 7, count, device="gun", holding=True)
                assert read == tuple(range(7, 7 + count))

    run(main())


def test_what_is_called_off_while_it_waits_for_its_turn_is_not_sent() -> None:
    async def main() -> None:
        async with lined("tcp") as (line, server, coils):
            halted = False

            def check() -> None:
                if halted:
                    raise Interrupted("halted", device="gun")

            server.faults.append(WireFault("late", 1.0, 1, READ_COILS))
            reading = asyncio.create_task(line.coils(1, 0, 1, device="gun"))
            setting = asyncio.create_task(line.set_coil(1, 3, True, device="gun", check=check))
            await asyncio.sleep(0.5)
            halted = True
            with pytest.raises(Interrupted):
                await setting
            assert await reading == (False,)
            assert coils.writes == 0

    run(main())
