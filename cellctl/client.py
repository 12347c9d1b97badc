"""Typed client of the API.

async with CellClient("http://127.0.0.1:8080", token) as cell:
    await cell.command("reset")
    await cell.until("Idle")
    order = await cell.post_job_order(JobOrderRequest(...), key="JO-1")
    async for event in cell.events(): ...
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx
from pydantic import BaseModel

from cellctl.api.problems import Problem
from cellctl.api.schemas import (
    Cell,
    CommandRequest,
    CommandTaken,
    DryRun,
    DryRunRequest,
    Health,
    JobOrder,
    JobOrderRequest,
    Joints,
    JournalPage,
    Recipes,
    Run,
    Runs,
    RunScans,
)

BASE = "/api/v1"
M = TypeVar("M", bound=BaseModel)


class ClientError(Exception):
    """The service refused; `problem` says why."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(f"{problem.status} {problem.code}: {problem.detail}")
        self.problem = problem


class CellClient:
    """One client of one cell. Raises ClientError for what is refused, httpx.TransportError for a lost link."""

    def __init__(
        self,
        url: str,
        token: str,
        *,
        transport: httpx.AsyncBaseTransport | None = None,
        timeout_s: float | None = 30.0,
    ) -> None:
        headers = {"Authorization": f"Bearer {token}"}
        self._http = httpx.AsyncClient(base_url=url, headers=headers, transport=transport, timeout=timeout_s)

    async def __aenter__(self) -> Self:
        await self._http.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._http.__aexit__(kind, error, trace)

    async def cell(self) -> Cell:
        """The cell at this instant."""
        return await self._get(Cell, "/cell")

    async def command(self, command: str, reason: str = "") -> CommandTaken:
        """Give a command."""
        asked = CommandRequest.model_validate({"command": command, "reason": reason})
        return await self._post(CommandTaken, "/cell/commands", asked)

    async def post_job_order(self, order: JobOrderRequest, *, key: str | None = None) -> JobOrder:
        """Order a run. With `key` it may be sent again without harm."""
        return await self._post(JobOrder, "/job-orders", order, {"Idempotency-Key": key} if key else {})

    async def job_order(self, job_order_id: str) -> JobOrder:
        """One order."""
        return await self._get(JobOrder, f"/job-orders/{job_order_id}")

    async def run(self, run_id: str) -> Run:
        """One run."""
        return await self._get(Run, f"/runs/{run_id}")

    async def runs(self, *, limit: int = 50, cursor: str | None = None) -> Runs:
        """A page of runs, newest first."""
        return await self._get(Runs, "/runs", {"limit": limit} | ({"cursor": cursor} if cursor else {}))

    async def journal(self, run_id: str, *, limit: int = 200, cursor: int = 0) -> JournalPage:
        """A page of a run's journal."""
        return await self._get(JournalPage, f"/runs/{run_id}/journal", {"limit": limit, "cursor": cursor})

    async def joints(self, run_id: str) -> Joints:
        """Every result of every joint of a run."""
        return await self._get(Joints, f"/runs/{run_id}/joints")

    async def scans(self, run_id: str) -> RunScans:
        """Every cloud of a run."""
        return await self._get(RunScans, f"/runs/{run_id}/scans")

    async def save_scan_page(self, run_id: str, path: Path) -> None:
        """Write the page of a run's newest measured scans to `path`."""
        await self._save(f"/runs/{run_id}/scans/page", path)

    async def save_record(self, run_id: str, path: Path) -> None:
        """Write the sealed record of a run to `path`."""
        await self._save(f"/runs/{run_id}/record", path)

    async def _save(self, what: str, path: Path) -> None:
        loop = asyncio.get_running_loop()
        async with self._http.stream("GET", BASE + what) as answer:
            if answer.is_error:
                await answer.aread()
                _refused(answer)
            file = await loop.run_in_executor(None, path.open, "wb")
            try:
                async for chunk in answer.aiter_bytes():
                    await loop.run_in_executor(None, file.write, chunk)
            finally:
                await loop.run_in_executor(None, file.close)

    async def recipes(self) -> Recipes:
        """The recipes that may be ordered."""
        return await self._get(Recipes, "/recipes")

    async def start_dry_run(self, asked: DryRunRequest) -> DryRun:
        """Begin a dry run."""
        return await self._post(DryRun, "/dry-runs", asked)

    async def dry_run(self, dry_run_id: str) -> DryRun:
        """One dry run."""
        return await self._get(DryRun, f"/dry-runs/{dry_run_id}")

    async def ready(self) -> Health:
        """Whether orders can be worked on; a 503 is an answer, not an error."""
        answer = await self._http.get(f"{BASE}/health/ready")
        return Health.model_validate_json(answer.content)

    async def events(self, after: int | str | None = None) -> AsyncIterator[dict[str, Any]]:
        """Events after that number or id (None: new ones only), each with `sequence`, `time`, `kind` and `data`.

        One of kind `gap` has kind and data only: events were missed, so read the cell again. Ends when the service
        ends the stream.
        """
        headers = {} if after is None else {"Last-Event-ID": str(after)}
        timeout = httpx.Timeout(self._http.timeout.connect, read=None)
        async with self._http.stream("GET", f"{BASE}/events", headers=headers, timeout=timeout) as answer:
            if answer.is_error:
                await answer.aread()
                _refused(answer)
            async for line in answer.aiter_lines():
                if line.startswith("data:"):
                    event = json.loads(line[5:])
                    yield event if "sequence" in event else {"kind": "gap", "data": event}

    async def until(self, *states: str) -> Cell:
        """Follow the events until the cell is in one of `states`."""
        cell = await self.cell()
        if cell.state in states:
            return cell
        async for event in self.events(cell.event_id):
            if event["kind"] == "gap" and (cell := await self.cell()).state in states:
                return cell
            if event["kind"] == "state" and event["data"]["state"] in states:
                return await self.cell()
        raise httpx.RemoteProtocolError("the event stream ended")

    async def _get(self, model: type[M], path: str, query: Mapping[str, Any] | None = None) -> M:
        return _answer(model, await self._http.get(BASE + path, params=query))

    async def _post(
        self, model: type[M], path: str, body: BaseModel, headers: Mapping[str, str | None] | None = None
    ) -> M:
        given = {"Content-Type": "application/json"} | {k: v for k, v in (headers or {}).items() if v is not None}
        content = body.model_dump_json(exclude_none=True)
        return _answer(model, await self._http.post(BASE + path, content=content, headers=given))


def _answer(model: type[M], answer: httpx.Response) -> M:
    if answer.is_error:
        _refused(answer)
    return model.model_validate_json(answer.content)


def _refused(answer: httpx.Response) -> None:
    try:
        problem = Problem.model_validate_json(answer.content)
    except ValueError:
        problem = Problem(title=answer.reason_phrase, status=answer.status_code, detail="", code="no_details")
    raise ClientError(problem)
