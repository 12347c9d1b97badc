"""Errors as problem details (RFC 9457): one shape for everything that is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from types import MappingProxyType

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from cellctl.states import Refused
from hal.errors import CellError

PHRASES: Mapping[int, str] = MappingProxyType({413: "Content Too Large", 422: "Unprocessable Content"})
"""Phrases of RFC 9110 where the library of an older Python has an older one."""
NOT_THERE = frozenset({"run_unknown", "scan_unknown", "scan_not_kept"})
"""Codes of errors that say that there is no such thing (404); every other one is a fault of the cell (503)."""


def title_of(status: int) -> str:
    """The phrase of a status, the same on every Python."""
    return PHRASES.get(status) or HTTPStatus(status).phrase


class Violation(BaseModel):
    """One thing that is wrong with a request. `pointer` is a JSON pointer (RFC 6901) or the name of a parameter."""

    pointer: str
    reason: str
    limit: str | None = None
    unit: str | None = None


class Problem(BaseModel):
    """Problem details. `code` is stable; `state` and `allowed_commands` are the cell's at that moment."""

    type: str = "about:blank"
    title: str
    status: int = Field(json_schema_extra={"unit": "1"})
    detail: str
    code: str
    state: str | None = None
    allowed_commands: list[str] | None = None
    violations: list[Violation] = []


class ProblemError(HTTPException):
    """Raise this to answer with problem details."""

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        *,
        violations: Sequence[Violation] = (),
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(status, detail, dict(headers) if headers else None)
        self.code = code
        self.violations = list(violations)


def install(app: FastAPI) -> None:
    """Every error of `app` becomes problem details. Needs `app.state.services`."""
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(Refused, _refused)
    app.add_exception_handler(CellError, _cell_error)
    app.add_exception_handler(Exception, _unforeseen)


def answer(request: Request, problem: Problem, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """`problem`, completed with the cell's state."""
    services = getattr(request.app.state, "services", None)
    if services is not None and problem.state is None:
        problem.state = str(services.controller.state)
        problem.allowed_commands = [str(command) for command in services.controller.allowed()]
    # Strings of the client may hold half a surrogate pair, which UTF-8 cannot.
    content = problem.model_dump_json(exclude_none=True).encode("utf-8", "replace")
    return _ProblemResponse(content, problem.status, headers)


class _ProblemResponse(JSONResponse):
    media_type = "application/problem+json"

    def __init__(self, content: bytes, status: int, headers: Mapping[str, str] | None) -> None:
        super().__init__(content, status, headers)

    def render(self, content: bytes) -> bytes:
        return content


async def _http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    title = title_of(error.status_code)
    code = error.code if isinstance(error, ProblemError) else title.lower().replace(" ", "_")
    violations = error.violations if isinstance(error, ProblemError) else []
    problem = Problem(title=title, status=error.status_code, detail=error.detail, code=code, violations=violations)
    return answer(request, problem, error.headers)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    violations = [_violation(item) for item in error.errors()[:50]]
    first = violations[0]
    detail = f"{first.pointer or 'body'}: {first.reason}"
    problem = Problem(title=title_of(422), status=422, detail=detail, code="invalid_request", violations=violations)
    return answer(request, problem)


def _violation(item: Mapping[str, object]) -> Violation:
    place = item.get("loc")
    parts = [_clean(str(part)) for part in place] if isinstance(place, tuple | list) else []
    kind, rest = (parts[0], parts[1:]) if parts else ("body", [])
    escaped = [part.replace("~", "~0").replace("/", "~1") for part in rest]
    pointer = "/" + "/".join(escaped) if kind == "body" and rest else "/".join(rest)
    context = item.get("ctx")
    limits = [str(context[key]) for key in ("ge", "gt", "le", "lt", "max_length", "min_length", "pattern", "expected")
              if key in context] if isinstance(context, dict) else []  # fmt: skip
    return Violation(pointer=pointer, reason=str(item.get("msg", "")), limit=", ".join(limits) or None)


def _clean(text: str) -> str:
    return text.encode("utf-8", "replace").decode()[:200]


async def _refused(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, Refused)
    problem = Problem(
        title=title_of(409),
        status=409,
        detail=str(error),
        code="command_not_allowed",
        state=str(error.state),
        allowed_commands=[str(command) for command in error.allowed],
    )
    return answer(request, problem)


async def _cell_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, CellError)
    status = 404 if error.code in NOT_THERE else 503
    problem = Problem(title=title_of(status), status=status, detail=str(error), code=error.code)
    return answer(request, problem)


async def _unforeseen(request: Request, error: Exception) -> JSONResponse:
    detail = "an error that was not foreseen; the service's log has it"
    return answer(request, Problem(title=title_of(500), status=500, detail=detail, code="internal_error"))
