"""What the guard tells the service manager: ready once its socket listens, then alive with its own cycle; a child
tells nothing."""

from __future__ import annotations

import asyncio
import os
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from hal.guard import __main__ as command
from hal.systemd import notify
from tests.dead.processes import cell_in


@pytest.fixture
def folder() -> Iterator[Path]:
    """Short: names of sockets are."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        yield Path(name)


@pytest.fixture
def manager(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The service manager's ear, with a limit of 0.2 s; this process stays an ordinary one."""
    monkeypatch.setenv("NOTIFY_SOCKET", str(folder / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "200000")
    monkeypatch.setattr(command, "never_paused", lambda: None)
    monkeypatch.setattr(command, "real_time", lambda priority: None)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(folder / "notify"))
        ear.setblocking(False)
        yield ear


def test_ready_once_it_listens_then_alive_with_every_few_cycles(
    folder: Path, manager: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = cell_in(folder)
    listened: list[bool] = []

    def told(state: str) -> None:
        listened.append(config.beside(config.guard.socket).is_socket())
        notify(state)

    monkeypatch.setattr(command, "notify", told)

    async def main() -> list[bytes]:
        loop = asyncio.get_running_loop()
        guard = asyncio.create_task(command.guard(config, child=False))
        async with asyncio.timeout(30.0):
            heard = [await loop.sock_recv(manager, 64) for _ in range(5)]
        guard.cancel()
        await asyncio.gather(guard, return_exceptions=True)
        return heard

    heard = asyncio.run(main())
    assert sorted(heard) == [b"READY=1", *[b"WATCHDOG=1"] * 4]
    assert listened == [True]


def test_a_child_says_nothing(folder: Path, manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    os.close(writing)
    config = cell_in(folder)
    with os.fdopen(reading) as ours:
        monkeypatch.setattr("sys.stdin", ours)
        asyncio.run(asyncio.wait_for(command.guard(config, child=True), 30.0))
    with pytest.raises(BlockingIOError):
        manager.recv(64)
