"""Who may do what: roles, bearer tokens, and the declaration that every route carries."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from inspect import iscoroutinefunction
from types import MappingProxyType
from typing import Annotated, Protocol

from fastapi import FastAPI, Request, Security
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, iter_route_contexts
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from cellctl.api.problems import ProblemError


class Role(StrEnum):
    """What somebody is to the cell."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    PROCESS_ENGINEER = "process_engineer"
    QUALITY = "quality"
    MAINTENANCE = "maintenance"
    MES = "mes"
    ADMIN = "admin"


_LINE = frozenset({Role.VIEWER, Role.OPERATOR})
INCLUDES: Mapping[Role, frozenset[Role]] = MappingProxyType(
    {
        Role.VIEWER: frozenset({Role.VIEWER}),
        Role.OPERATOR: _LINE,
        Role.PROCESS_ENGINEER: _LINE | {Role.PROCESS_ENGINEER},
        Role.QUALITY: _LINE | {Role.QUALITY},
        Role.MAINTENANCE: _LINE | {Role.MAINTENANCE},
        Role.MES: frozenset({Role.VIEWER, Role.MES}),
        Role.ADMIN: frozenset(Role),
    }
)
"""What each role may do besides its own."""


@dataclass(frozen=True, slots=True)
class Principal:
    """Who asks."""

    name: str
    role: Role


class Authenticator(Protocol):
    """Says who a token belongs to, or None."""

    def principal(self, token: str) -> Principal | None: ...


class DemoAuth:
    """Fixed users behind one secret: the token itself is the admin's, ``<role>.<token>`` belongs to that role.

    Accepted by the composition root only on a loopback host with fake devices.
    """

    def __init__(self, token: str | None = None) -> None:
        self.token = token or secrets.token_urlsafe(24)

    def principal(self, token: str) -> Principal | None:
        """Compared in constant time, each user's token every time."""
        found = None
        for role in Role:
            expected = self.token if role is Role.ADMIN else f"{role}.{self.token}"
            if hmac.compare_digest(expected.encode(), token.encode("utf-8", "replace")):
                found = Principal(f"demo-{role}", role)
        return found


_BEARER = HTTPBearer(
    auto_error=False, description="Bearer token; demo mode prints one and writes it to the data folder"
)


class Allow:
    """Declares the roles of a route, as its dependency; answers 401 or 403 to everybody else."""

    def __init__(self, *roles: Role) -> None:
        self.roles = frozenset(roles)

    async def __call__(
        self, request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)]
    ) -> Principal:
        """Who asks, if it is one of the declared roles."""
        challenge = {"WWW-Authenticate": "Bearer"}
        if credentials is None:
            raise ProblemError(401, "not_signed_in", "a bearer token is needed", headers=challenge)
        authenticator: Authenticator = request.app.state.services.auth
        who = authenticator.principal(credentials.credentials)
        if who is None:
            raise ProblemError(401, "token_unknown", "the bearer token is not known", headers=challenge)
        if not INCLUDES[who.role] & self.roles:
            needed = ", ".join(sorted(self.roles))
            raise ProblemError(403, "role_missing", f"{who.role} may not do this; needed: {needed}")
        return who


class Public:
    """Declares a route that anybody may read."""

    async def __call__(self) -> None:
        """Nothing to check."""


@dataclass(frozen=True, slots=True)
class Declared:
    """A route with what it declares: roles, public, or nothing."""

    path: str
    methods: tuple[str, ...]
    in_schema: bool
    coroutine: bool
    access: Allow | Public | None


def declared(app: FastAPI) -> Iterator[Declared]:
    """Every route of `app`."""
    for route in iter_route_contexts(app.routes):
        is_api = isinstance(route.original_route, APIRoute)
        yield Declared(
            path=route.path or "",
            methods=tuple(sorted(route.methods or ())),
            in_schema=is_api and route.include_in_schema,
            coroutine=iscoroutinefunction(route.endpoint),
            access=_access(route.dependant) if is_api else None,
        )


def undeclared(app: FastAPI) -> list[str]:
    """The routes of `app` that declare no role: there must be none."""
    return [f"{'/'.join(route.methods)} {route.path}" for route in declared(app) if route.access is None]


def _access(dependant: Dependant) -> Allow | Public | None:
    waiting = [dependant]
    while waiting:
        each = waiting.pop()
        if isinstance(each.call, Allow | Public):
            return each.call
        waiting.extend(each.dependencies)
    return None
