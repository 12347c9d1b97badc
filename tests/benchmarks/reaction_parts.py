"""Processes of the reaction benchmark: `python -m tests.benchmarks.reaction_parts PART ...`.

floor PTY PORT                  a bare loop: bytes of a pty in, one line to a socket out, then when they were read
vision FOLDER                   the vision core on the stored scan again and again, as the controller's worker does it
thread KIND CELL FOLDER         the guard in a thread, vision of that kind in the same process
together CELL FOLDER COMMAND... guard and vision in threads of the service that the command starts
load URL TOKEN RATE             requests against the API; prints how many a second came back, each second
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from cellctl.__main__ import main as cellctl
from hal.bus import can
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
CONNECTIONS = 16
PATIENT_S = 1000.0


def floor(pty: str, port: str) -> None:
    """With the priority of the guard."""

    async def main() -> None:
        with socket.create_connection(("127.0.0.1", int(port))) as peer:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.sendall(b"O\r")
            line, file = encode(STOP), os.open(pty, os.O_RDWR | os.O_NOCTTY)

            def read() -> None:
                if OVER in os.read(file, 65536):
                    read_s = time.perf_counter()
                    peer.send(line)
                    print(read_s, flush=True)

            asyncio.get_running_loop().add_reader(file, read)
            print("ready", flush=True)
            await asyncio.Event().wait()

    never_paused()
    real_time(REAL_TIME)
    asyncio.run(main())


def vision(folder: str) -> None:
    """For ever, at the niceness of a worker."""
    os.nice(NICENESS)
    see = _seeing("ours", Path(folder))
    print("ready", flush=True)
    see()


def _seeing(kind: str, folder: Path) -> Callable[[], None]:
    """What measures the stored scan for ever."""
    measure = pipeline(kind, folder, {})
    cloud = np.load(folder / "grid.npy")

    def see() -> None:
        while True:
            measure(cloud)

    return see


def thread(kind: str, cell: str, folder: str) -> None:
    """The same guard, with the same priority for its thread, but one interpreter for both."""
    see = _seeing(kind, Path(folder))
    _guard_in_a_thread(cell)
    see()


def together(cell: str, folder: str, *command: str) -> None:
    """One interpreter for guard, vision and service: the cell controller as one process."""
    see = _seeing("ours", Path(folder))
    _guard_in_a_thread(cell)
    threading.Thread(target=see, daemon=True).start()
    sys.exit(cellctl(command))


def _guard_in_a_thread(cell: str) -> None:
    can.SILENCE_S = PATIENT_S  # or it would be busy with opening the bus anew where the interpreter is held for seconds

    async def guard() -> None:
        config = load_cell(Path(cell))
        assert config.can is not None
        process = GuardProcess(config, CanBus(config.can.described, node=config.can.node))
        await process.start()
        real_time(REAL_TIME)
        await asyncio.Event().wait()

    threading.Thread(target=lambda: asyncio.run(guard()), daemon=True).start()


class Asking(asyncio.Protocol):
    """One connection, one request at a time. A request that falls due while one is open follows that at once."""

    def __init__(self, request: bytes, period_s: float) -> None:
        self._request, self._period_s = request, period_s
        self._heard = b""
        self._due_s = 0.0
        self.answered = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        assert isinstance(transport, asyncio.Transport)
        self._transport, self._loop = transport, asyncio.get_running_loop()
        self._due_s = self._loop.time()
        self._ask()

    def _ask(self) -> None:
        self._due_s += self._period_s
        self._transport.write(self._request)

    def data_received(self, data: bytes) -> None:
        """Once the answer is whole, the next request has its time."""
        self._heard += data
        head, ended, body = self._heard.partition(b"\r\n\r\n")
        if not ended:
            return
        if not head.startswith(b"HTTP/1.1 200 "):
            raise SystemExit(f"the API says {self._heard!r}")
        if len(body) >= int(head.split(b"content-length: ")[1].split(b"\r\n")[0]):
            self._heard = b""
            self.answered += 1
            self._loop.call_at(self._due_s, self._ask)


def load(url: str, token: str, rate: str) -> None:
    """Evenly over a few connections."""
    asyncio.run(_load(url, token, float(rate)))


async def _load(url: str, token: str, rate: float) -> None:
    loop, at = asyncio.get_running_loop(), urlsplit(url)
    request = f"GET /api/v1/cell HTTP/1.1\r\nHost: {at.netloc}\r\nAuthorization: Bearer {token}\r\n\r\n".encode()
    asking = []
    for _ in range(CONNECTIONS):
        _, one = await loop.create_connection(lambda: Asking(request, CONNECTIONS / rate), at.hostname, at.port)
        asking.append(one)
        await asyncio.sleep(1.0 / rate)
    while True:
        before, begun_s = sum(one.answered for one in asking), loop.time()
        await asyncio.sleep(1.0)
        now = sum(one.answered for one in asking)
        print(f"{(now - before) / (loop.time() - begun_s):.1f}", flush=True)


if __name__ == "__main__":
    parts = {"floor": floor, "vision": vision, "thread": thread, "together": together, "load": load}
    parts[sys.argv[1]](*sys.argv[2:])
