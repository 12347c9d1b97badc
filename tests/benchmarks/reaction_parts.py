"""Processes of the reaction benchmark: `python -m tests.benchmarks.reaction_parts PART ...`.

floor PTY PORT         a bare loop: bytes of a pty in, one line to a socket out, nothing else
vision FOLDER          the vision core on the stored scan again and again, as the controller's worker does it
thread CELL FOLDER     the guard in a thread, vision in the same process
load URL TOKEN RATE    requests against the API; prints how many a second came back, each second
"""

from __future__ import annotations

import asyncio
import itertools
import os
import socket
import sys
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from hal.bus.can import CanBus
from hal.codec.cia301 import RPDO1
from hal.codec.lawicel import CanFrame, encode
from hal.config import load_cell
from hal.guard.__main__ import REAL_TIME
from hal.guard.process import GuardProcess
from hal.job_worker import NICENESS
from hal.priority import never_paused, real_time
from tests.benchmarks.worker import pipeline

STOP = CanFrame(RPDO1 + 3, b"\x02\x00\x01")
OVER = b"+9999"
"""What only the sample begins with that must be reacted to."""
CONNECTIONS = 4


def floor(pty: str, port: str) -> None:
    """With the priority of the guard."""

    async def main() -> None:
        with socket.create_connection(("127.0.0.1", int(port))) as peer:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.sendall(b"O\r")
            line, file = encode(STOP), os.open(pty, os.O_RDWR | os.O_NOCTTY)

            def read() -> None:
                if OVER in os.read(file, 65536):
                    peer.send(line)

            asyncio.get_running_loop().add_reader(file, read)
            print("ready", flush=True)
            await asyncio.Event().wait()

    never_paused()
    real_time(REAL_TIME)
    asyncio.run(main())


def vision(folder: str) -> None:
    """For ever, at the niceness of a worker."""
    os.nice(NICENESS)
    _see("ours", Path(folder))


def _see(kind: str, folder: Path) -> None:
    measure = pipeline(kind, folder, {})
    cloud = np.load(folder / "grid.npy")
    print("ready", flush=True)
    while True:
        measure(cloud)


def thread(kind: str, cell: str, folder: str) -> None:
    """The same guard, with the same priority for its thread, but one interpreter for both."""

    async def guard() -> None:
        config = load_cell(Path(cell))
        assert config.can is not None
        process = GuardProcess(config, CanBus(config.can.described, node=config.can.node))
        await process.start()
        real_time(REAL_TIME)
        await asyncio.Event().wait()

    threading.Thread(target=lambda: asyncio.run(guard()), daemon=True).start()
    _see(kind, Path(folder))


def load(url: str, token: str, rate: str) -> None:
    """Evenly over a few connections."""
    asyncio.run(_load(urlsplit(url), token, float(rate)))


async def _load(url: object, token: str, rate: float) -> None:
    host, port = url.hostname, url.port  # type: ignore[attr-defined]
    request = f"GET /api/v1/cell HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\n\r\n".encode()
    answered = itertools.count()

    async def ask(first: int) -> None:
        reader, writer = await asyncio.open_connection(host, port)
        begun = time.monotonic()
        for number in itertools.count(first, CONNECTIONS):
            await asyncio.sleep(begun + number / rate - time.monotonic())
            writer.write(request)
            head = (await reader.readuntil(b"\r\n\r\n")).lower()
            if b" 200 " not in head.split(b"\r\n")[0]:
                raise SystemExit(f"the API says {head!r}")
            length = head.split(b"content-length:")[1].split(b"\r\n")[0]
            await reader.readexactly(int(length))
            next(answered)

    tasks = [asyncio.create_task(ask(first)) for first in range(CONNECTIONS)]
    while not any(task.done() for task in tasks):
        before = next(answered)
        begun = time.monotonic()
        await asyncio.sleep(1.0)
        print(f"{(next(answered) - before - 1) / (time.monotonic() - begun):.1f}", flush=True)
    await asyncio.gather(*tasks)


if __name__ == "__main__":
    {"floor": floor, "vision": vision, "thread": thread, "load": load}[sys.argv[1]](*sys.argv[2:])
