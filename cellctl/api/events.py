"""The event stream: server-sent events, numbered without a gap, replayed from Last-Event-ID on.

An id is BOOT-SEQUENCE: numbers begin at 1 with each start of the service, so a number alone may be an older one's.
"""

from __future__ import annotations

import json
import re
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
EVENT_ID = re.compile(r"(?:[0-9]{1,20}-)?[0-9]{1,16}")
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
    """Every event after Last-Event-ID (or number `after`), then each new one; without either, new ones only.

    An event named `gap` without an id comes first where asked for events that are not kept any more, or that another
    start of the service told: then read the cell again. Last-Event-ID may be a number alone; of a low one nothing can
    be known.
    """
    log = services.events
    asked = log.id_of(log.last if after is None else after)
    if last_event_id:
        if not EVENT_ID.fullmatch(last_event_id):
            raise ProblemError(422, "invalid_request", "Last-Event-ID is not the id of an event")
        asked = last_event_id if "-" in last_event_id else log.id_of(int(last_event_id))
    return EventSourceResponse(_stream(log, asked), ping=PING_S * services.wall_s)


async def _stream(log: EventLog, asked: str) -> AsyncIterator[ServerSentEvent]:
    boot, _, number = asked.partition("-")
    start = int(number)
    if boot != log.boot or start > log.last or start + 1 < log.first:
        first = log.first
        yield ServerSentEvent(event="gap", data=json.dumps({"asked_after": start, "first": first}))
        start = first - 1
    async for event in log.follow(start):
        yield _sent(event, log.id_of(event.sequence))


def _sent(event: Event, event_id: str) -> ServerSentEvent:
    told = {"sequence": event.sequence, "time": rfc3339(event.time), "kind": event.kind, "data": dict(event.data)}
    return ServerSentEvent(id=event_id, event=event.kind, data=json.dumps(told, allow_nan=False))
