"""Scans of a run: which were taken, and pages that show them with what was measured in them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from fastapi.responses import StreamingResponse

from cellctl.api.auth import Allow, Role
from cellctl.api.schemas import RunScan, RunScans
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.records.errors import UnknownRun
from cellctl.view.of_run import SIDES, page_in

CHUNK_BYTES = 1 << 18
VIEWER = [Depends(Allow(Role.VIEWER))]
PAGE: dict[int | str, dict[str, Any]] = {
    200: {"description": "One HTML page that is whole in itself", "content": {"text/html": {}}}
}
POLICY = "sandbox allow-scripts allow-modals; default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""The page's own policy lets its one script alone run; the sandbox keeps it away from everything of this origin."""
router = APIRouter(route_class=StrictRoute, tags=["scans"])


@router.get("/runs/{run_id}/scans", dependencies=VIEWER)
async def all_scans(run_id: str, services: Annotated[Services, Depends(services_of)]) -> RunScans:
    """Every cloud of a run, in the order in which they were taken."""
    try:
        scans = await services.runs.scans(run_id)
    except UnknownRun:
        if services.orders.of_run(run_id) is None:
            raise
        scans = ()  # ordered, and without a journal (yet)
    items = [
        RunScan(view=scan.view, frame_id=scan.frame_id, taken=datetime.fromisoformat(scan.utc),
             measured=scan.placed, refused=scan.refused or None, kept=kept)
        for scan, kept in scans
    ]  # fmt: skip
    return RunScans(items=items)


@router.get("/runs/{run_id}/scans/page", response_class=StreamingResponse, responses=PAGE, dependencies=VIEWER)
async def both_sides(run_id: str, services: Annotated[Services, Depends(services_of)]) -> StreamingResponse:
    """The newest measured scan of each side and their alignment; 404 where none was measured or its cloud is gone."""
    folder = services.runs.folder_of(run_id)
    return _answer(run_id, await services.jobs.run(page_in, folder, SIDES, None, latency_s=0.0))


@router.get("/runs/{run_id}/scans/{view}/page", response_class=StreamingResponse, responses=PAGE, dependencies=VIEWER)
async def one_side(
    run_id: str,
    view: Literal["rotor", "shaft"],
    services: Annotated[Services, Depends(services_of)],
    frame_id: Annotated[int | None, Query(ge=0, le=2**53, description="default: the newest that was measured")] = None,
) -> StreamingResponse:
    """One measured scan of one side."""
    folder = services.runs.folder_of(run_id)
    return _answer(run_id, await services.jobs.run(page_in, folder, (view,), frame_id, latency_s=0.0))


def _answer(run_id: str, page: bytes) -> StreamingResponse:
    headers = {
        "Content-Security-Policy": POLICY,
        "X-Content-Type-Options": "nosniff",
        "Content-Disposition": f'inline; filename="{run_id}-scans.html"',
        "Content-Length": str(len(page)),
    }
    return StreamingResponse(_pieces(page), media_type="text/html; charset=utf-8", headers=headers)


async def _pieces(page: bytes) -> AsyncIterator[bytes]:
    """Piece by piece, so that no callback of the loop handles megabytes."""
    for start in range(0, len(page), CHUNK_BYTES):
        yield page[start : start + CHUNK_BYTES]
