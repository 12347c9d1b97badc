"""The serial port: latency timer, exclusive use, pulled and plugged."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from hal.bus.pty import Pty
from hal.bus.serial import SerialLine, set_latency


def ignore(_: object) -> None:
    """Nobody listens."""


def on_pty(path: Path, case: Callable[[Pty], Coroutine[Any, Any, None]], on_bytes: Callable[[bytes], None]) -> None:
    async def main() -> None:
        pty = Pty(path, on_bytes)
        pty.plug()
        try:
            await case(pty)
        finally:
            pty.unplug()

    asyncio.run(main())


def test_bytes_pass_unchanged_both_ways(tmp_path: Path) -> None:
    every = bytes(range(256))
    heard: asyncio.Queue[bytes] = asyncio.Queue()

    async def case(pty: Pty) -> None:
        came: asyncio.Queue[bytes] = asyncio.Queue()
        line = SerialLine(str(pty.path), 460_800, came.put_nowait, ignore)
        assert line.latency_ms is None, "a pseudo-terminal has no latency timer"
        line.write(every)
        pty.write(every)
        data = b""
        while len(data) < 256:
            data += await came.get()
        said = b""
        while len(said) < 256:
            said += await heard.get()
        line.close()
        line.close()
        assert data == said == every

    on_pty(tmp_path / "port", case, heard.put_nowait)


def test_a_port_has_one_owner(tmp_path: Path) -> None:
    async def case(pty: Pty) -> None:
        line = SerialLine(str(pty.path), 460_800, ignore, ignore)
        with pytest.raises(OSError, match="lock"):
            SerialLine(str(pty.path), 460_800, ignore, ignore)
        line.close()
        SerialLine(str(pty.path), 460_800, ignore, ignore).close()

    on_pty(tmp_path / "port", case, ignore)


def test_what_was_sent_to_nobody_is_not_read(tmp_path: Path) -> None:
    async def case(pty: Pty) -> None:
        pty.write(b"old")
        came: asyncio.Queue[bytes] = asyncio.Queue()
        line = SerialLine(str(pty.path), 460_800, came.put_nowait, ignore)
        pty.write(b"young")
        assert await came.get() == b"young"
        line.close()

    on_pty(tmp_path / "port", case, ignore)


def test_a_pulled_cable_is_heard_of_once_and_another_port_is_found_at_the_same_path(tmp_path: Path) -> None:
    async def case(pty: Pty) -> None:
        lost: asyncio.Queue[str] = asyncio.Queue()
        line = SerialLine(str(pty.path), 460_800, ignore, lost.put_nowait)
        for _ in range(20):
            pty.unplug()
            assert await lost.get()
            assert not line.is_open
            with pytest.raises(OSError, match="closed"):
                line.write(b"x")
            with pytest.raises(FileNotFoundError):
                SerialLine(str(pty.path), 460_800, ignore, ignore)
            pty.plug()
            line = SerialLine(str(pty.path), 460_800, ignore, lost.put_nowait)
        line.close()
        assert lost.empty()

    on_pty(tmp_path / "port", case, ignore)


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="ascii")

    async def main() -> None:
        with pytest.raises(OSError, match="no serial port"):
            SerialLine(str(tmp_path / "file"), 460_800, ignore, ignore)

    asyncio.run(main())


def latency_file(root: Path, text: str) -> Path:
    timer = root / "bus/usb-serial/devices/ttyUSB7/latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text(text, encoding="ascii")
    return timer


def test_a_usb_adapter_is_set_to_one_millisecond(tmp_path: Path) -> None:
    timer = latency_file(tmp_path, "16\n")
    assert set_latency("/dev/ttyUSB7", tmp_path) == 1
    assert timer.read_text(encoding="ascii") == "1"
    assert set_latency("/dev/ttyS0", tmp_path) is None


def test_a_latency_that_stays_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    latency_file(tmp_path, "16\n")
    monkeypatch.setattr(Path, "write_text", lambda *_, **__: 0)  # as where the right to write is missing
    with pytest.raises(OSError, match="16 ms"):
        set_latency("/dev/ttyUSB7", tmp_path)
