"""Who may do what, and that no route is forgotten."""

from __future__ import annotations

from pathlib import Path

import pytest
from fastapi import FastAPI

from cellctl.api.app import create_app
from cellctl.api.auth import INCLUDES, Allow, DemoAuth, Public, Role, declared, undeclared
from tests.api.harness import ORDER, Api, run_api

PUBLIC = {"/", "/page/{name}", "/api/v1/health/live", "/api/v1/health/ready", "/health/live", "/health/ready"}


def test_every_route_declares_its_roles() -> None:
    routes = list(declared(create_app(None)))
    assert len(routes) > 20
    assert {route.path for route in routes if isinstance(route.access, Public)} == PUBLIC


def test_a_route_without_a_role_is_found() -> None:
    app = FastAPI()

    @app.get("/open")
    async def forgotten() -> str:
        return ""

    assert "GET /open" in undeclared(app)


def test_every_handler_is_a_coroutine() -> None:
    """A plain handler costs a thread and breaks virtual time."""
    assert [route.path for route in declared(create_app(None)) if not route.coroutine] == []


def test_without_a_token_nothing_but_health_is_told(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        for route in declared(api.app):
            if isinstance(route.access, Allow):
                for method in route.methods:
                    answer = await api.client.request(method, route.path)
                    assert answer.status_code == 401, route.path
                    assert answer.headers["www-authenticate"] == "Bearer"
        assert (await api.client.get("/api/v1/health/live")).json()["status"] == "live"

    run_api(tmp_path, body, role="")


def test_a_wrong_token_is_refused(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        for token in ("secre", "secret2", "viewer.", "nobody.secret", "ä"):
            headers = {"Authorization": f"Bearer {token}".encode()}
            answer = await api.client.get("/api/v1/cell", headers=headers)
            assert (answer.status_code, answer.json()["code"]) == (401, "token_unknown")

    run_api(tmp_path, body, role="")


@pytest.mark.parametrize(
    ("role", "order", "stop", "reset"),
    [("viewer", 403, 403, 403), ("operator", 409, 409, 202), ("mes", 409, 409, 403), ("quality", 409, 409, 202)],
)
def test_what_a_role_may_do(tmp_path: Path, role: str, order: int, stop: int, reset: int) -> None:
    """The cell is Stopped: 409 means that the role was good enough."""

    async def body(api: Api) -> None:
        assert (await api.client.get("/api/v1/cell")).status_code == 200
        assert (await api.client.post("/api/v1/job-orders", json=ORDER)).status_code == order
        for command, status in (("stop", stop), ("reset", reset)):
            answer = await api.client.post("/api/v1/cell/commands", json={"command": command})
            assert answer.status_code == status

    run_api(tmp_path, body, role=role)


def test_each_user_of_the_demo_has_one_role() -> None:
    auth = DemoAuth("t")
    assert {str(role): auth.principal("t" if role is Role.ADMIN else f"{role}.t") for role in Role}.keys() == set(Role)
    for role in Role:
        who = auth.principal("t" if role is Role.ADMIN else f"{role}.t")
        assert who is not None
        assert who.role is role
        assert role in INCLUDES[role]
    assert len(DemoAuth().token) >= 32
