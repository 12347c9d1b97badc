"""The service over real sockets on a quickened clock: a whole order, bad clients, an end that nobody holds up."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from cellctl.api.schemas import JobOrderRequest
from cellctl.api.server import Server, bound, make_server
from cellctl.client import CellClient, ClientError
from hal.clock import QuickenedLoop
from tests.api.harness import ORDER, TOKEN, Api, api

SPEED = 60.0


@dataclass
class Served:
    """The API behind a port."""

    api: Api
    server: Server
    port: int

    def client(self) -> CellClient:
        """A signed-in client over HTTP."""
        return CellClient(f"http://127.0.0.1:{self.port}", TOKEN, timeout_s=30 * SPEED)

    async def raw(self, data: bytes) -> bytes:
        """Everything that the service answers to `data` until it hangs up."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        writer.write(data)
        await writer.drain()
        answer = await reader.read()
        writer.close()
        await writer.wait_closed()
        return answer


@asynccontextmanager
async def served(data: Path) -> AsyncIterator[Served]:
    async with api(data, wall_s=SPEED) as given:
        server = make_server(given.app, wall_s=SPEED)
        task = asyncio.create_task(server.serve_on(bound("127.0.0.1", 0)))
        await server.listening.wait()
        try:
            yield Served(given, server, server.port)
        finally:
            given.services.events.close()
            server.stop()
            await task


def run_served(data: Path, body: Callable[[Served], Awaitable[None]]) -> None:
    async def main() -> None:
        async with served(data) as given:
            await body(given)

    with asyncio.Runner(loop_factory=lambda: QuickenedLoop(SPEED)) as runner:
        runner.run(main())


def test_an_order_is_followed_to_its_record(tmp_path: Path) -> None:
    async def body(given: Served) -> None:
        async with given.client() as cell:
            await cell.command("reset")
            await cell.until("Idle")
            start = (await cell.cell()).event_sequence
            order = await cell.post_job_order(JobOrderRequest.model_validate(ORDER), key="k")
            seen = []
            async for event in cell.events(start):
                seen.append(event["sequence"])
                if event["kind"] == "run_ended":
                    break
            await cell.until("Complete")
            assert seen == list(range(start + 1, start + 1 + len(seen)))
            run = await cell.run(order.run_id)
            assert (run.verdict, run.sealed) == ("accepted", True)
            await cell.save_record(order.run_id, tmp_path / "record.zip")
            assert (tmp_path / "record.zip").read_bytes()[:2] == b"PK"
            with pytest.raises(ClientError) as caught:
                await cell.command("hold")
            assert caught.value.problem.allowed_commands == ["reset", "stop", "abort"]

    run_served(tmp_path, body)


def test_an_open_event_stream_does_not_hold_up_the_end(tmp_path: Path) -> None:
    async def body(given: Served) -> None:
        async def watch() -> None:
            async with given.client() as cell:
                async for _ in cell.events(0):
                    pass

        watchers = [asyncio.create_task(watch()) for _ in range(3)]
        await given.api.idle()
        await asyncio.sleep(0.2 * SPEED)
        began = time.perf_counter()
        given.api.services.events.close()
        given.server.stop()
        await asyncio.gather(*watchers)
        assert time.perf_counter() - began < 2.0

    run_served(tmp_path, body)


def test_bad_clients_are_answered_or_hung_up_on_and_the_loop_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cellctl.api.server.HEADER_LIMIT_S", 0.3)
    monkeypatch.setattr("cellctl.api.app.READ_LIMIT_S", 0.3)
    head = f"POST /api/v1/job-orders HTTP/1.1\r\nHost: c\r\nAuthorization: Bearer {TOKEN}\r\n".encode()
    json = head + b"Content-Type: application/json\r\n"

    async def body(given: Served) -> None:
        slowest = 0.0

        async def turn() -> None:
            nonlocal slowest
            while True:
                began = time.perf_counter()
                await asyncio.sleep(0)
                slowest = max(slowest, time.perf_counter() - began)
                await asyncio.sleep(0.002 * SPEED)

        turning = asyncio.create_task(turn())
        half_headers = given.raw(b"POST /api/v1/job-orders HTT")
        silent = given.raw(b"")
        half_body = given.raw(json + b'Content-Length: 100\r\n\r\n{"job_order_id"')
        large = given.raw(json + b"Connection: close\r\nContent-Length: 12000000\r\n\r\n" + b"[1,2]," * 2_000_000)
        nothing = given.raw(b"\x00\x01\x02\r\n\r\n")
        answers = await asyncio.gather(half_headers, silent, half_body, large, nothing)
        turning.cancel()
        assert answers[0] == b""
        assert answers[1] == b""
        assert answers[2].startswith(b"HTTP/1.1 408 ")
        assert answers[3].startswith(b"HTTP/1.1 413 ")
        assert answers[4].startswith(b"HTTP/1.1 400 ")
        assert slowest < 0.1
        async with given.client() as cell:
            assert (await cell.cell()).state == "Stopped"

    run_served(tmp_path, body)
