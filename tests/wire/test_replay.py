"""Recorded buses are played back to the real backends: they say what they said then, and hear what they heard."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hal.bus.hub import CanHub
from hal.capture import Record, read_capture
from hal.errors import ConfigError, DeviceError
from hal.fake.wire.replay import Replay, on_can, on_serial, on_tcp
from hal.interfaces import Band
from tests.contract.backends import quickened
from tests.wire import replayed

CAPTURES = Path(__file__).parent / "captures"
STAGE_X = 1


def records_of(name: str) -> tuple[Record, ...]:
    """Of one recording."""
    return read_capture(CAPTURES / f"{name}.jsonl")[1]


def quick(main: Coroutine[Any, Any, None]) -> None:
    """A busy machine makes nothing late on this loop."""
    quickened(main, 20.0)


async def ended(replay: Replay) -> str:
    """The first difference, once the replay has come to its end; empty where there is none."""
    async with asyncio.timeout(30.0):
        await replay.done.wait()
    return replay.difference


def test_a_gun_tightens_as_recorded() -> None:
    async def main() -> None:
        async with on_tcp(records_of("gun")) as (replay, port):
            result = await replayed.gun(str(port))
            assert await ended(replay) == ""
        assert (result.key, result.controller_serial, result.tightening_id) == ("capture-1", "gun_a-1", 1)
        assert (result.ok, result.torque_band, result.angle_band) == (False, Band.LOW, Band.OK)
        assert len(result.trace.torque_nm) == 3002
        assert result.trace.angle_deg[-1] == pytest.approx(1080.36)

    quick(main())


def test_a_heater_over_modbus_heats_as_recorded() -> None:
    async def main() -> None:
        async with on_tcp(records_of("heater")) as (replay, port):
            state = await replayed.heater(str(port))
            assert await ended(replay) == ""
        assert (state.setpoint_c, state.on, state.watchdog_armed, state.alarm) == (30.0, True, True, "")

    quick(main())


def test_a_force_stream_is_read_as_recorded(tmp_path: Path) -> None:
    async def main() -> None:
        async with on_serial(records_of("force"), tmp_path / "force") as replay:
            block = await replayed.force(str(tmp_path / "force"))
            assert await ended(replay) == ""
        assert (block.sequence, block.period_s) == (0, 0.01)
        assert block.samples_n[[0, 3, 24]] == pytest.approx([0.076, -0.1334, -0.0482])

    quick(main())


@contextlib.asynccontextmanager
async def stage_x() -> AsyncIterator[tuple[Replay, str]]:
    """The recorded drive on a bus, and where that is."""
    hub = CanHub()
    await hub.start()
    try:
        async with on_can(records_of("axis"), hub) as replays:
            yield replays[STAGE_X], str(hub.port)
    finally:
        await hub.close()


def test_an_axis_on_can_moves_as_recorded() -> None:
    async def main() -> None:
        async with stage_x() as (replay, port):
            state = await replayed.axis(port)
            assert await ended(replay) == ""
        assert state.position == pytest.approx(0.5, abs=1e-6)
        assert state.homed

    quick(main())


def test_another_target_is_a_difference_at_its_frame() -> None:
    async def main() -> None:
        async with stage_x() as (replay, port):
            with pytest.raises(DeviceError):
                await replayed.axis(port, 0.75)
            target = int(0.75 * 10_000).to_bytes(4, "little").hex().upper()
            assert f"the controller says b't3018{target}" in await ended(replay)
            assert replay.difference.startswith("line ")

    quick(main())


def test_the_first_difference_is_told_with_its_place() -> None:
    async def main() -> None:
        async with on_tcp(records_of("gun")) as (replay, port):
            program = replace(replayed.SNUG, stage="another")
            with pytest.raises(DeviceError, match="no parameter set tells"):
                await replayed.gun(str(port), program)
            assert "line" in await ended(replay)
            assert "byte" in replay.difference
            assert "recorded b'" in replay.difference

    quick(main())


def test_what_is_said_beyond_the_end_is_a_difference() -> None:
    async def main() -> None:
        sent: list[Record] = []
        replay = Replay((Record(0.0, "out", b"ab"), Record(0.0, "in", b"c")), sent.append)
        replay.start()
        for piece in (b"a", b"b"):
            replay.heard(piece)
            await asyncio.sleep(0.01)
        assert await ended(replay) == ""
        assert [one.data for one in sent] == [b"c"]
        replay.heard(b"d")
        assert "beyond the end" in replay.difference
        await replay.close()

    quick(main())


Spoil = Callable[[list[str]], list[str]]


@pytest.mark.parametrize(
    ("spoil", "place"),
    [
        (lambda lines: [], "heater.jsonl"),
        (lambda lines: ['{"capture": 2}', *lines[1:]], "heater.jsonl:1"),
        (lambda lines: [*lines[:4], '{"t": 1.0, "link": 1, "dir": "up", "hex": "00"}'], "heater.jsonl:5"),
        (lambda lines: [*lines[:2], '{"t": 1.0, "link": 1, "dir": "in", "hex": "0"}'], "heater.jsonl:3"),
        (lambda lines: [*lines[:2], "[]"], "heater.jsonl:3"),
        (lambda lines: [*lines[:2], lines[2][:-5]], "heater.jsonl"),
    ],
)
def test_a_file_that_is_no_capture_is_told_with_its_place(tmp_path: Path, spoil: Spoil, place: str) -> None:
    lines = (CAPTURES / "heater.jsonl").read_text(encoding="ascii").splitlines()
    path = tmp_path / "heater.jsonl"
    path.write_text("\n".join(spoil(lines)), encoding="ascii")
    with pytest.raises(ConfigError) as told:
        read_capture(path)
    assert told.value.place == place
