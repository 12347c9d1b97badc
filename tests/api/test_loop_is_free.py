"""What would hold the controller's loop is done elsewhere, or once before the service says that it is ready."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cellctl.api.runs import journal
from cellctl.api.schemas import JournalPage
from cellctl.api.server import bound
from cellctl.records.chain import Row

WARM = """
import asyncio, sys
from fastapi import FastAPI
from dataclasses import dataclass
from cellctl.app import _warm
@dataclass
class Services:
    auth: object
app = FastAPI()
app.state.services = Services(None)
asyncio.run(_warm(app))
before = set(sys.modules)
async def stream():
    import httpx
    from fastapi.responses import StreamingResponse
    async def pieces():
        yield b"piece"
    async with httpx.AsyncClient(transport=httpx.ASGITransport(StreamingResponse(pieces()))) as client:
        await client.get("http://here")
asyncio.run(stream())
print(*sorted(set(sys.modules) - before))
"""


def test_rows_of_a_journal_are_read_and_written_outside_of_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: list[int] = []
    value: Any = Row.value

    def seen(row: Row) -> Any:
        parsed.append(threading.get_ident())
        return value.fget(row)

    async def rows(run_id: str, *, after: int, limit: int) -> tuple[Row, ...]:
        return (Row(1, 0.5, "2000-01-01T00:00:00Z", "phase", '{"name":"scan"}', "", "h1"),)

    monkeypatch.setattr(Row, "value", property(seen))
    services: Any = SimpleNamespace(runs=SimpleNamespace(rows=rows))
    answer = asyncio.run(journal("run-1", services, 1, 0))
    page = JournalPage.model_validate_json(bytes(answer.body))
    assert (page.items[0].value, page.cursor) == ({"name": "scan"}, 1)
    assert len(parsed) == 1
    assert threading.get_ident() not in parsed


def test_the_first_stream_imports_nothing_any_more(root: Path) -> None:
    done = subprocess.run([sys.executable, "-c", WARM], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_small_answers_do_not_wait_for_each_other() -> None:
    async def nagle() -> int:
        came = asyncio.get_running_loop().create_future()

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            one = writer.get_extra_info("socket")
            came.set_result(one.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        sock = bound("127.0.0.1", 0)
        async with await asyncio.start_server(serve, sock=sock):
            _, writer = await asyncio.open_connection(*sock.getsockname())
            told = await came
            writer.close()
            await writer.wait_closed()
        return int(told)

    assert asyncio.run(nagle())
