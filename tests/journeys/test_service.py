"""The service as a process of its own: served, stopped, killed, started again."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from cellctl.api.schemas import JobOrderRequest
from cellctl.client import CellClient, ClientError
from tests.api.harness import ORDER

ROOT = Path(__file__).parents[2]
START_LIMIT_S = 60.0


@dataclass
class Process:
    """A running `cellctl serve`."""

    process: asyncio.subprocess.Process
    url: str
    token: str

    def client(self) -> CellClient:
        return CellClient(self.url, self.token)

    async def end(self, number: int) -> int:
        """Send a signal; the exit code."""
        self.process.send_signal(number)
        async with asyncio.timeout(20.0):
            return await self.process.wait()


@asynccontextmanager
async def service(data: Path, *options: str) -> AsyncIterator[Process]:
    command = [
        sys.executable, "-m", "cellctl", "serve", "--cell", str(ROOT / "deploy/cell.fake.toml"), "--port", "0",
        "--speed", "60", "--data", str(data), "--json", *options,
    ]  # fmt: skip
    process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    try:
        async with asyncio.timeout(START_LIMIT_S):
            told = json.loads(await process.stdout.readline())
        yield Process(process, told["url"], told["token"])
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


def children_of(process_id: int) -> list[int]:
    """Process ids of the direct children."""
    lists = Path(f"/proc/{process_id}/task").glob("*/children")  # one for each thread
    return [int(child) for each in lists for child in each.read_text().split()]


def alive(process_id: int) -> bool:
    """Whether the process exists and is not merely waiting to be collected."""
    try:
        stat = Path(f"/proc/{process_id}/stat").read_text()
    except OSError:
        return False
    return stat.rsplit(")", 1)[1].split()[0] != "Z"


async def gone(process_ids: list[int]) -> bool:
    """Whether all of these processes end within a few seconds."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(10.0):
            while any(alive(each) for each in process_ids):  # noqa: ASYNC110  # other processes set no event of ours
                await asyncio.sleep(0.05)
    return not any(alive(each) for each in process_ids)


def test_a_signal_stops_the_run_and_ends_the_service_in_order(tmp_path: Path) -> None:
    async def main() -> None:
        async with service(tmp_path) as given, given.client() as cell:
            await cell.until("Idle")
            token_file = tmp_path / "demo-token"
            assert token_file.read_text().strip() == given.token
            assert token_file.stat().st_mode & 0o077 == 0
            order = await cell.post_job_order(JobOrderRequest.model_validate(ORDER), key="k")
            assert (await cell.run(order.run_id)).state == "Starting"
            workers = children_of(given.process.pid)
            assert workers
            began = time.monotonic()
            assert await given.end(signal.SIGTERM) == 0
            assert time.monotonic() - began < 10.0
            assert await gone(workers)
        lines = [json.loads(line) for line in (tmp_path / "orders.jsonl").read_text().splitlines()]
        assert lines[-1]["ended"]["ending"] == "stopped"

    asyncio.run(main())


def test_after_a_kill_the_cell_comes_back_aborted_and_a_person_brings_it_to_idle(tmp_path: Path) -> None:
    async def main() -> None:
        async with service(tmp_path) as given, given.client() as cell:
            await cell.until("Idle")
            order = await cell.post_job_order(JobOrderRequest.model_validate(ORDER), key="k")
            workers = children_of(given.process.pid)
            assert workers
            assert await given.end(signal.SIGKILL) == -signal.SIGKILL
            assert await gone(workers)
        async with service(tmp_path) as again, again.client() as cell:
            now = await cell.until("Aborted")
            assert order.run_id in now.why
            assert (await cell.job_order("JO-1")).state == "Aborted"
            assert await cell.post_job_order(JobOrderRequest.model_validate(ORDER), key="k") == order
            with pytest.raises(ClientError, match="cell_not_idle"):
                await cell.post_job_order(JobOrderRequest.model_validate(ORDER | {"job_order_id": "JO-2"}))
            await cell.command("clear")
            await cell.until("Stopped")
            await cell.command("reset")
            await cell.until("Idle")
            assert await again.end(signal.SIGINT) == 0

    asyncio.run(main())
