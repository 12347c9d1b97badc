"""Whether the service lives, whether it can work, and its numbers."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from fastapi.responses import PlainTextResponse

from cellctl.api.auth import Allow, Public, Role
from cellctl.api.schemas import Health
from cellctl.api.services import Services, services_of

router = APIRouter(tags=["health"])


@router.get("/health/live", dependencies=[Depends(Public())])
async def live() -> Health:
    """Answers as long as the loop turns."""
    return Health(status="live", reason="")


@router.get("/health/ready", responses={503: {"model": Health}}, dependencies=[Depends(Public())])
async def ready(response: Response, services: Annotated[Services, Depends(services_of)]) -> Health:
    """503 with the reason while no order can be worked on."""
    reason = services.not_ready()
    response.status_code = 503 if reason else 200
    return Health(status="not_ready" if reason else "ready", reason=reason)


@router.get("/metrics", response_class=PlainTextResponse, dependencies=[Depends(Allow(Role.VIEWER))])
async def metrics(services: Annotated[Services, Depends(services_of)]) -> PlainTextResponse:
    """Prometheus text."""
    media_type = "text/plain; version=0.0.4; charset=utf-8"
    return PlainTextResponse(services.metrics.text(), media_type=media_type)
