"""Faults on the line of a force amplifier: always the true error, never a wrong or an old sample."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import numpy as np
import pytest

from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, NotConnected
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.force import ForceAmplifier
from hal.interfaces import ForceBlock
from hal.real.force import SerialForceSensor
from tests.contract import wire_force
from tests.contract.backends import WireBackend, plant_of, quickened
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase

Case = Callable[[ForceAmplifier, SerialForceSensor], Coroutine[Any, Any, None]]
TIMES = 20
SPEED = 10.0
LATE_S = 0.2
"""Loop time that a busy machine's kernel may hold a line back at this speed."""


def on_wire(case: Case, *faults: Fault, connect: bool = True) -> None:
    """Run `case` on an amplifier and its backend, whose deadlines are short, under quickened time."""

    async def main() -> None:
        async with wire_force.wired(
            "gun_force_a", plant_of("ideal"), FaultBook(faults), reply_s=0.5, silence_s=0.5
        ) as made:
            amplifier, sensor = made
            if connect:
                await sensor.connect()
            await case(amplifier, sensor)

    quickened(main(), SPEED)


async def steps(sensor: SerialForceSensor, blocks: int, count: int = 3) -> list[tuple[int, int]]:
    """Of consecutive blocks: samples in it, and how many are missing before it."""
    read = [await sensor.block(count) for _ in range(blocks)]
    missing = [b.sequence - a.sequence - len(a.samples_n) for a, b in itertools.pairwise(read)]
    return list(zip([len(block.samples_n) for block in read[1:]], missing, strict=True))


def test_a_reader_that_left_leaves_nothing_old_to_the_next() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        for _ in range(TIMES):
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(2.0):
                    await sensor.block(1000)
            asked_s = asyncio.get_running_loop().time()
            assert (await sensor.block(1)).time_s > asked_s - LATE_S

    on_wire(case)


@pytest.mark.parametrize("kind", ["drop", "corrupt", "half"])
def test_a_line_that_is_lost_or_broken_is_a_gap(kind: str) -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        for _ in range(TIMES):
            before = await sensor.block(1)
            setattr(amplifier.wire, kind, 1)
            missing = 0
            while not missing:
                after = await sensor.block(3)
                missing = after.sequence - before.sequence - len(before.samples_n)
                before = after
            # Half a line spoils the one that it runs into, too.
            assert missing == (2 if kind == "half" else 1)

    on_wire(case)


def test_a_block_ends_before_a_gap_and_the_next_begins_after_it() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        await sensor.block(1)
        loop = asyncio.get_running_loop()
        loop.call_later(10.5 / sensor.rate_hz, setattr, amplifier.wire, "drop", 2)
        before = await sensor.block(100)
        after = await sensor.block(5)
        assert 5 <= len(before.samples_n) < 100
        assert after.sequence == before.sequence + len(before.samples_n) + 2
        assert after.time_s == pytest.approx(
            before.time_s + (after.sequence - before.sequence) / sensor.rate_hz, abs=0.01
        )

    on_wire(case)


def test_a_line_that_comes_twice_counts_once() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        await sensor.block(1)
        amplifier.wire.repeat = TIMES
        assert await steps(sensor, 20, 5) == [(5, 0)] * 19

    on_wire(case)


def test_a_stream_that_repeats_itself_is_implausible_and_comes_back() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        last = await sensor.block(5)
        amplifier.wire.frozen = True
        with pytest.raises(ImplausibleReading, match="repeats"):
            await until_error(sensor)
        amplifier.wire.frozen = False
        assert (await sensor.block(5)).sequence > last.sequence + 5

    on_wire(case)


def test_an_unreadable_line_is_named() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        await sensor.block(5)
        amplifier.wire.garbage = True
        with pytest.raises(DeviceFault, match="unreadable lines"):
            await until_error(sensor)
        amplifier.wire.garbage = False
        await sensor.block(5)

    # Garbage has line feeds by chance only; a wire that is merely broken has them all.
    async def broken(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        await sensor.block(5)
        amplifier.wire.corrupt = 10**6
        with pytest.raises(DeviceFault, match="checksum"):
            await until_error(sensor)

    on_wire(broken)
    on_wire(case)


async def until_error(sensor: SerialForceSensor) -> None:
    """Read until it fails; every block must be young."""
    while True:
        block = await sensor.block(5)
        age_s = asyncio.get_running_loop().time() - block.time_s - (len(block.samples_n) - 1) * block.period_s
        assert age_s < LATE_S


@pytest.mark.parametrize("value", [250.0, -1e6])
def test_beyond_its_range_it_reads_the_end_of_the_range(value: float) -> None:
    async def case(_: ForceAmplifier, sensor: SerialForceSensor) -> None:
        await asyncio.sleep(2.0)
        await sensor.block(1)
        block = await sensor.block(50, low_n=-100.0, high_n=100.0)
        assert len(block.samples_n) == 1
        assert block.samples_n[0] == np.copysign(sensor.range_n, value)

    on_wire(case, Fault("gun_force_a", "out_of_range", value=value, at_s=1.0))


def test_a_pulled_cable_ends_the_block_at_once_and_plugged_back_it_goes_on() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        last = await sensor.block(5)
        loop = asyncio.get_running_loop()
        for _ in range(TIMES):
            reading = asyncio.create_task(sensor.block(1000))
            await asyncio.sleep(0.1)
            pulled_s = loop.time()
            amplifier.unplug()
            with pytest.raises(NotConnected, match="line broke"):
                await reading
            for command in (sensor.halt, sensor.safe, sensor.rearm, partial(sensor.block, 1)):
                with pytest.raises(NotConnected, match="gun_force_a"):
                    await command()
            assert loop.time() - pulled_s < LATE_S
            amplifier.plug()
            block = await sensor.block(5)
            assert block.sequence > last.sequence + len(last.samples_n), "what was missed shows in the numbering"
            assert block.time_s > pulled_s - block.period_s
            last = block

    on_wire(case)


def test_a_power_cycle_ends_the_stream_and_a_rearm_starts_it() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        last = await sensor.block(5)
        await amplifier.power_off()
        assert "nothing at present" in (await sensor.safe()).detail
        await sensor.rearm()
        block = await sensor.block(5)
        assert block.sequence > last.sequence + 5
        await amplifier.power_off()
        with pytest.raises(DeviceTimeout, match="no sample"):
            await sensor.block(5)
        assert (await sensor.block(5)).sequence > block.sequence + 5

    on_wire(case)


def test_a_late_answer_is_not_taken_for_the_next() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        identity = await sensor.connect()
        for _ in range(TIMES):
            amplifier.wire.late_answers = 1
            with pytest.raises(DeviceTimeout, match="state"):
                await sensor.halt()
            assert await sensor.connect() == identity

    on_wire(case)


def test_lines_that_come_late_are_old_samples() -> None:
    async def case(_: ForceAmplifier, sensor: SerialForceSensor) -> None:
        await sensor.block(5)
        await asyncio.sleep(2.0)
        block = await sensor.block(5)
        age_s = asyncio.get_running_loop().time() - block.time_s - 4 * block.period_s
        assert 0.4 < age_s < 0.5 + LATE_S

    on_wire(case, Fault("gun_force_a", "late", value=0.5, at_s=1.0))


def test_another_amplifier_is_refused() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        amplifier.unplug()
        amplifier.serial = "another"
        await asyncio.sleep(0.01)
        amplifier.plug()
        with pytest.raises(DeviceRefused, match="another answers, gun_force_a-1 is meant"):
            await sensor.block(1)
        await sensor.close()
        assert (await sensor.connect()).serial == "another", "a connect takes whoever is there"

    on_wire(case)


def test_an_amplifier_that_is_set_otherwise_is_refused() -> None:
    async def case(amplifier: ForceAmplifier, sensor: SerialForceSensor) -> None:
        entry = sensor._entry.model_copy(update={"rate_hz": 50.0})
        other = SerialForceSensor("gun_force_a", entry)
        with pytest.raises(DeviceRefused, match="100 Hz, 200 N, the cell file says 50 Hz"):
            await other.connect()
        await sensor.connect()

    on_wire(case, connect=False)


def test_it_has_one_reader_and_one_that_gives_up_takes_nothing() -> None:
    async def case(_: ForceAmplifier, sensor: SerialForceSensor) -> None:
        before = await sensor.block(1)
        reading = asyncio.create_task(sensor.block(50))
        await asyncio.sleep(5 / sensor.rate_hz)
        with pytest.raises(DeviceRefused, match="one reader"):
            await sensor.block(1)
        reading.cancel()
        await asyncio.wait({reading})
        assert (await sensor.block(1)).sequence == before.sequence + 1

    on_wire(case)


def test_a_reader_that_stays_away_finds_young_samples_and_a_gap() -> None:
    async def case(_: ForceAmplifier, sensor: SerialForceSensor) -> None:
        before = await sensor.block(1)
        await asyncio.sleep(1.0)
        block: ForceBlock = await sensor.block(1)
        assert block.sequence > before.sequence + 50
        assert asyncio.get_running_loop().time() - block.time_s < 0.1 + LATE_S

    on_wire(case)


def test_closing_ends_a_reader() -> None:
    async def case(_: ForceAmplifier, sensor: SerialForceSensor) -> None:
        reading = asyncio.create_task(sensor.block(1000))
        await asyncio.sleep(0.1)
        await sensor.close()
        with pytest.raises(NotConnected, match="closed"):
            await reading
        await sensor.close()

    on_wire(case)


WIRE = WireBackend(wire_force.installed, speed=SPEED)
QUICK = WireBackend(wire_force.installed, speed=100.0)


@pytest.mark.parametrize("name", ["jack_force", "gun_force_a"])
@pytest.mark.parametrize("case", CONNECTED)
def test_it_is_a_device_like_any_other(case: DeviceCase, name: str) -> None:
    case(WIRE, name)


@pytest.mark.parametrize("name", ["jack_force", "gun_force_a"])
@pytest.mark.parametrize("case", UNANSWERED)
def test_it_does_not_connect_where_nothing_answers_and_always_closes(case: DeviceCase, name: str) -> None:
    case(QUICK, name)
