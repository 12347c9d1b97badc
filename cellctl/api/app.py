"""The API as one ASGI application: routes, limits, problem details, the operator's page."""

from __future__ import annotations

from fastapi import FastAPI
from starlette.types import ASGIApp

from cellctl.api import cell, dry_runs, events, health, job_orders, openapi, page, problems, recipes, runs, scans
from cellctl.api.auth import undeclared
from cellctl.api.limits import BodyLimits
from cellctl.api.services import Services

BASE = "/api/v1"
READ_LIMIT_S = 10.0
"""How long a client may take to send a body, in seconds of the wall."""


def create_app(services: Services | None) -> FastAPI:
    """The application. Without services it can only describe itself. Raises where a route declares no role."""

    # The documentation pages of FastAPI need files from outside the cell, so there are none.
    app = FastAPI(
        title="cellctl",
        version="1.1.0",
        summary="Cell controller of the shaft assembly",
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        redirect_slashes=False,
    )
    app.state.services = services
    for module in (cell, job_orders, runs, scans, recipes, dry_runs, events, openapi):
        app.include_router(module.router, prefix=BASE)
    app.include_router(health.router, prefix=BASE)
    app.include_router(health.router, include_in_schema=False)
    app.include_router(page.router, include_in_schema=False)
    missing = undeclared(app)
    if missing:
        raise RuntimeError(f"routes without a declared role: {', '.join(missing)}")
    problems.install(app)
    openapi.describe(app)
    wall_s = services.wall_s if services is not None else 1.0
    app.add_middleware(_limited, read_limit_s=READ_LIMIT_S * wall_s)
    return app


def _limited(app: ASGIApp, *, read_limit_s: float) -> BodyLimits:
    return BodyLimits(app, read_limit_s=read_limit_s)
