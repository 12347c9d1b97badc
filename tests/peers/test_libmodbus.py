"""The thermal backend against a libmodbus server, over TCP and RTU."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import shlex
import subprocess
import tty
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from hal.bus.modbus import Lines, Link
from hal.errors import DeviceRefused, DeviceTimeout, NotConnected
from hal.interfaces import Quality
from tests.contract.wire_modbus import UNIT, device
from tests.peers.peers import HERE, line_of, met_debian, program, running

pytestmark = pytest.mark.peers
PYROMETER, HEATER = 0x100, 0x200
FRAMINGS = pytest.mark.parametrize("framing", ["tcp", "rtu"])


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The server, compiled against the system's libmodbus."""
    met_debian("libmodbus-dev")
    made = tmp_path_factory.mktemp("peers") / "thermal_server"
    flags = subprocess.run(
        [program("pkg-config"), "--cflags", "--libs", "libmodbus"], capture_output=True, text=True, check=True
    )
    source = str(HERE / "thermal_server.c")
    command = [program("cc"), "-Wall", "-Wextra", "-o", str(made), source, *shlex.split(flags.stdout)]
    subprocess.run(command, check=True)
    return str(made)


@contextlib.contextmanager
def two_ptys() -> Iterator[tuple[int, int, str, str]]:
    """Two pseudo-terminals: their near ends, and the paths of their far ends."""
    near, far = zip(*(os.openpty() for _ in range(2)), strict=True)
    for end in (*near, *far):
        tty.setraw(end)
    try:
        yield near[0], near[1], os.ttyname(far[0]), os.ttyname(far[1])
    finally:
        for end in (*near, *far):
            os.close(end)


@contextlib.asynccontextmanager
async def cable() -> AsyncIterator[tuple[str, str]]:
    """A serial line between two paths."""
    loop = asyncio.get_running_loop()
    with two_ptys() as (one, other, path, far_path):
        for source, sink in ((one, other), (other, one)):
            loop.add_reader(source, lambda a=source, b=sink: os.write(b, os.read(a, 1024)))
        try:
            yield path, far_path
        finally:
            loop.remove_reader(one)
            loop.remove_reader(other)


@contextlib.asynccontextmanager
async def served(server: str, framing: str) -> AsyncIterator[tuple[dict[str, Any], asyncio.subprocess.Process]]:
    """What the entry of a device must say to reach the server, and the server."""
    if framing == "tcp":
        async with running(server, "tcp") as process:
            yield {"port": int(await line_of(process))}, process
    else:
        async with cable() as (ours, theirs), running(server, "rtu", theirs) as process:
            assert await line_of(process) == "ready"
            yield {"port_path": ours, "parity": "N", "framing": "rtu"}, process


@contextlib.asynccontextmanager
async def devices(link: dict[str, Any], **bases: int) -> AsyncIterator[list[Any]]:
    """Devices by name and base, on one line, closed in the end."""
    lines = Lines()
    more = {"heater": {"watchdog_s": 1.0}}
    made = [device(name, lines, base=base, **link, **more.get(name, {})) for name, base in bases.items()]
    try:
        yield made
    finally:
        for one in made:
            await one.close()


@FRAMINGS
def test_temperatures_are_read(server: str, framing: str) -> None:
    async def main() -> None:
        async with (
            served(server, framing) as (link, _),
            devices(link, spigot_tc_1=0, pyrometer=PYROMETER) as (couple, pyrometer),
        ):
            identity = await couple.connect()
            assert (identity.vendor, identity.model, identity.serial) == ("libmodbus", "thermal server", "TS-9")
            assert not identity.simulated
            await pyrometer.connect()
            for _ in range(20):
                for one, value in ((couple, 21.25), (pyrometer, 180.5)):
                    reading = await one.read()
                    assert (reading.value, reading.quality) == (value, Quality.GOOD)
            before = (await couple.read()).time_s
            assert before < (await couple.read()).time_s, "each conversion has its own time"
            await couple._line.write(UNIT, 2, (1,), device="test")
            broken = await couple.read()
            assert math.isnan(broken.value)
            assert broken.quality is Quality.BAD

    asyncio.run(main())


@FRAMINGS
def test_another_emissivity_or_serial_number_is_refused(server: str, framing: str) -> None:
    async def main() -> None:
        async with served(server, framing) as (link, _):
            for changes, reason in (({"emissivity": 0.9}, "emissivity set to 0.950"), ({"serial": "TS-8"}, "TS-9")):
                async with devices(link | changes, pyrometer=PYROMETER) as (pyrometer,):
                    with pytest.raises(DeviceRefused, match=reason):
                        await pyrometer.connect()

    asyncio.run(main())


@FRAMINGS
def test_the_heater_heats_and_its_watchdog_ends_it(server: str, framing: str) -> None:
    async def main() -> None:
        async with served(server, framing) as (link, _):
            async with devices(link, heater=HEATER) as (heater,):
                await heater.connect()
                assert (await heater.safe()).safe
                state = await heater.heat(180.0, ramp_k_per_min=30.0, max_power_w=2500.0)
                assert (state.setpoint_c, state.power_w, state.on) == (180.0, 2500.0, True)
                assert state.watchdog_armed
                assert not (await heater.safe()).safe
                await asyncio.sleep(2.0)
                assert (await heater.read()).on, "the line's monitor feeds the watchdog"
                assert not (await heater.off()).on
                await heater.halt()
                await heater.heat(100.0, ramp_k_per_min=30.0, max_power_w=500.0)
            await asyncio.sleep(1.5)
            async with devices(link, heater=HEATER) as (heater,):
                await heater.connect()
                state = await heater.read()
                assert (state.on, state.alarm) == (False, "watchdog")
                with pytest.raises(DeviceRefused, match="alarm"):
                    await heater.heat(100.0, ramp_k_per_min=30.0, max_power_w=500.0)
                await heater.rearm()
                assert (await heater.heat(100.0, ramp_k_per_min=30.0, max_power_w=500.0)).on
                await heater.off()

    asyncio.run(main())


@FRAMINGS
def test_its_exceptions_and_its_silence_have_their_own_errors(server: str, framing: str) -> None:
    async def main() -> None:
        async with served(server, framing) as (link, process), devices(link, spigot_tc_1=0) as (couple,):
            await couple.connect()
            line = couple._line
            assert isinstance(line.link, Link)
            with pytest.raises(DeviceRefused, match="illegal_address"):
                await line.read(UNIT, 0x1100, 2, device="spigot_tc_1")
            assert (await couple.read()).value == 21.25
            process.kill()
            await process.wait()
            with pytest.raises((NotConnected, DeviceTimeout), match="spigot_tc_1"):
                await couple.read()

    asyncio.run(main())
