"""Runs: what was done, row by row, joint by joint, and the sealed record."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from fastapi.responses import HTMLResponse, StreamingResponse

from cellctl.api.auth import Allow, Role
from cellctl.api.bolts import bolts_of, recipe_in
from cellctl.api.problems import ProblemError
from cellctl.api.schemas import Joint, Joints, JournalPage, JournalRow, Phase, Run, Runs, Serials
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.records.chain import Row
from cellctl.records.errors import UnknownRun
from cellctl.records.summary import RunSummary

CHUNK_BYTES = 1 << 18
VIEWER = [Depends(Allow(Role.VIEWER))]
router = APIRouter(route_class=StrictRoute, tags=["runs"])


@router.get("/runs", dependencies=VIEWER)
async def all_runs(
    services: Annotated[Services, Depends(services_of)],
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(max_length=80)] = None,
) -> Runs:
    """Runs, newest first."""
    found = await services.runs.list(limit=limit + 1, after=cursor)
    items = [_told(summary, services) for summary in found[:limit]]
    return Runs(items=items, cursor=items[-1].run_id if len(found) > limit else None)


@router.get("/runs/{run_id}", dependencies=VIEWER)
async def one_run(run_id: str, services: Annotated[Services, Depends(services_of)]) -> Run:
    """One run; while it runs `state` is the cell's."""
    summary = await _summary(run_id, services)
    return _told(summary, services) if summary else _without_journal(run_id, services)


@router.get("/runs/{run_id}/journal", response_model=JournalPage, dependencies=VIEWER)
async def journal(
    run_id: str,
    services: Annotated[Services, Depends(services_of)],
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    cursor: Annotated[int, Query(ge=0, le=2**53)] = 0,
) -> Response:
    """Rows of the journal, oldest first."""
    rows = await services.runs.rows(run_id, after=cursor, limit=limit)
    # A thousand rows are parsed and written for tens of milliseconds: not in the loop.
    page = await asyncio.get_running_loop().run_in_executor(None, _page, rows, limit)
    return Response(page, media_type="application/json")


def _page(rows: Sequence[Row], limit: int) -> str:
    items = [
        JournalRow(seq=row.seq, time_s=row.time_s, utc=row.utc, kind=row.kind, value=row.value, prev=row.prev,
                   hash=row.hash)
        for row in rows
    ]  # fmt: skip
    return JournalPage(items=items, cursor=rows[-1].seq if len(rows) == limit else None).model_dump_json()


@router.get("/runs/{run_id}/joints", dependencies=VIEWER)
async def joints(run_id: str, services: Annotated[Services, Depends(services_of)]) -> Joints:
    """Every result of every joint, in the order in which they were made."""
    summary = await _summary(run_id, services)
    if summary is None:
        return Joints(count=None, items=[])
    header = await services.runs.rows(run_id, limit=1)
    recipe = recipe_in(header[0].value) if header else None  # the run's own: the book may hold another by now
    items = [
        Joint(
            index=joint["index"],
            gun=joint["gun"],
            stage=joint["stage"],
            torque_nm=joint["torque_nm"],
            angle_deg=joint["angle_deg"],
            verdict=joint["verdict"],
            simulated=services.simulated,
        )
        for joint in summary.joints
    ]
    if recipe is None:
        return Joints(count=None, items=items)
    return Joints(count=recipe.pattern.count, items=items, bolts=bolts_of(recipe, summary.joints))


@router.get(
    "/runs/{run_id}/record",
    response_class=StreamingResponse,
    responses={200: {"description": "The sealed record", "content": {"application/zip": {}}}},
    dependencies=VIEWER,
)
async def record(run_id: str, services: Annotated[Services, Depends(services_of)]) -> StreamingResponse:
    """The sealed record; 404 until the run is sealed."""
    try:
        path = services.runs.record_path(run_id)
    except UnknownRun:
        if services.orders.of_run(run_id) is None:
            raise
        path = None
    if path is None:
        raise ProblemError(404, "record_not_sealed", "the run has no sealed record yet")
    headers = {"Content-Disposition": f'attachment; filename="{run_id}.zip"'}
    return StreamingResponse(_chunks(path), media_type="application/zip", headers=headers)


@router.get("/runs/{run_id}/report", response_class=HTMLResponse, dependencies=VIEWER)
async def report(run_id: str, services: Annotated[Services, Depends(services_of)]) -> HTMLResponse:
    """The report as HTML, from what is in the journal now."""
    policy = {"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src data:"}
    return HTMLResponse(await services.runs.report(run_id), headers=policy)


async def _chunks(path: Path) -> AsyncIterator[bytes]:
    """A file piece by piece, read outside of the loop."""
    loop = asyncio.get_running_loop()
    offset = 0
    while chunk := await loop.run_in_executor(None, _read, path, offset):
        offset += len(chunk)
        yield chunk


def _read(path: Path, offset: int) -> bytes:
    with path.open("rb") as file:
        file.seek(offset)
        return file.read(CHUNK_BYTES)


async def _summary(run_id: str, services: Services) -> RunSummary | None:
    """None for a run that was ordered and has no journal (yet). Raises UnknownRun for any other."""
    try:
        return await services.runs.get(run_id)
    except UnknownRun:
        if services.orders.of_run(run_id) is not None:
            return None
        raise


def _told(summary: RunSummary, services: Services) -> Run:
    live = summary.state == "Running" and services.controller.snapshot().run_id == summary.run_id
    state = str(services.controller.state) if live else summary.state
    if summary.state == "Running" and not live:
        state = "Aborted"  # the service ended while it ran: nothing more will be written
    return Run(
        run_id=summary.run_id,
        job_order_id=summary.job_order_id,
        recipe=summary.recipe,
        recipe_version=summary.recipe_version,
        serials=Serials(rotor=summary.rotor_serial, shaft=summary.shaft_serial),
        state=state,
        verdict=summary.verdict,
        reasons=list(summary.reasons),
        phases=[Phase(name=each.name, state=each.state, cell_time_s=each.cell_time_s) for each in summary.phases],
        started=datetime.fromisoformat(summary.started_utc) if summary.started_utc else None,
        ended=datetime.fromisoformat(summary.ended_utc) if summary.ended_utc else None,
        journal_hash=summary.journal_hash,
        sealed=summary.state != "Running" and services.runs.record_path(summary.run_id) is not None,
        simulated=services.simulated,
    )


def _without_journal(run_id: str, services: Services) -> Run:
    order = services.orders.of_run(run_id)
    assert order is not None, "seen by _summary"
    wanted = order.wanted
    return Run(
        run_id=run_id,
        job_order_id=wanted.job_order_id,
        recipe=wanted.recipe,
        recipe_version=wanted.recipe_version,
        serials=Serials(rotor=wanted.rotor_serial, shaft=wanted.shaft_serial),
        state=order.ending.capitalize() if order.ending else str(services.controller.state),
        verdict=order.verdict,
        reasons=list(order.reasons),
        phases=[],
        started=None,
        ended=None,
        journal_hash=None,
        sealed=False,
        simulated=services.simulated,
    )
