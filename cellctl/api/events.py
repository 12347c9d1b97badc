"""The event stream: server-sent events, numbered without a gap, replayed from Last-Event-ID on."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query
from sse_starlette import EventSourceResponse, ServerSentEvent

from cellctl.api.auth import Allow, Role
from cellctl.api.problems import ProblemError
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.event_log import Event, EventLog
from cellctl.stamps import rfc3339

PING_S = 15.0
router = APIRouter(route_class=StrictRoute, tags=["events"])


@router.get(
    "/events",
    response_class=EventSourceResponse,
    responses={200: {"description": "Server-sent events", "content": {"text/event-stream": {}}}},
    dependencies=[Depends(Allow(Role.VIEWER))],
)
async def events(
    services: Annotated[Services, Depends(services_of)],
    last_event_id: Annotated[str | None, Header()] = None,
    after: Annotated[int | None, Query(ge=0, le=2**53)] = None,
) -> EventSourceResponse:
    """Every event after Last-Event-ID (or `after`), then each new one; without either, new ones only.

    An event named `gap` without an id comes first where asked for events that are not kept any more.
    """
    log = services.events
    start = log.last if after is None else after
    if last_event_id:
        if not (last_event_id.isascii() and last_event_id.isdigit() and len(last_event_id) < 17):
            raise ProblemError(422, "invalid_request", "Last-Event-ID is not the number of an event")
        start = int(last_event_id)
    return EventSourceResponse(_stream(log, start), ping=PING_S * services.wall_s)


async def _stream(log: EventLog, start: int) -> AsyncIterator[ServerSentEvent]:
    if start > log.last or start + 1 < log.first:
        first = log.first
        yield ServerSentEvent(event="gap", data=json.dumps({"asked_after": start, "first": first}))
        start = first - 1
    async for event in log.follow(start):
        yield _sent(event)


def _sent(event: Event) -> ServerSentEvent:
    told = {"sequence": event.sequence, "time": rfc3339(event.time), "kind": event.kind, "data": dict(event.data)}
    return ServerSentEvent(id=str(event.sequence), event=event.kind, data=json.dumps(told, allow_nan=False))
