"""The description of the API (OpenAPI 3.1): problem details on every route, roles, a unit on every number.

``python -m cellctl.api.openapi deploy/openapi.json`` writes the frozen copy.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Depends, FastAPI, Request
from fastapi.openapi.utils import get_openapi

from cellctl.api.auth import Allow, Declared, Role, declared
from cellctl.api.problems import Problem

PROBLEM = {
    "description": "Problem details (RFC 9457)",
    "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
}
router = APIRouter(tags=["openapi"])


@router.get("/openapi.json", dependencies=[Depends(Allow(Role.VIEWER))])
async def openapi_document(request: Request) -> dict[str, Any]:
    """This description."""
    app: FastAPI = request.app
    return app.openapi()


def describe(app: FastAPI) -> None:
    """Let `app` describe itself with what FastAPI does not know."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]  # the place that FastAPI names for this


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title, version=app.version, summary=app.summary, openapi_version="3.1.0", routes=app.routes
    )
    schemas = document["components"]["schemas"]
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs"))
    schemas["Problem"] = problem
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for route in declared(app):
        if route.in_schema:
            for method in route.methods:
                _complete(document["paths"][route.path][method.lower()], route)
    for place, node in numbers(document):
        if "unit" not in node and "integer" in place[1]:
            node["unit"] = "1"  # whole numbers count something
    return document


def _complete(operation: dict[str, Any], route: Declared) -> None:
    operation["responses"].pop("422", None)
    operation["responses"]["4XX"] = PROBLEM
    operation["x-roles"] = sorted(route.access.roles) if isinstance(route.access, Allow) else ["public"]


def numbers(node: Any, path: str = "") -> Iterator[tuple[tuple[str, tuple[str, ...]], dict[str, Any]]]:
    """Every schema of a number below `node`: its path, its types, the schema itself."""
    if isinstance(node, dict):
        kind = node.get("type")
        types = tuple(kind) if isinstance(kind, list) else (kind,) if isinstance(kind, str) else ()
        if {"number", "integer"} & set(types):
            yield (path, types), node
        for key, value in node.items():
            yield from numbers(value, f"{path}/{key}")
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from numbers(value, f"{path}/{index}")


def text_of(document: dict[str, Any]) -> str:
    """The document as it is frozen."""
    return json.dumps(document, indent=1, sort_keys=True) + "\n"


def main(path: Path) -> None:
    """Write the description of the API to `path`."""
    from cellctl.api.app import create_app

    path.write_text(text_of(create_app(None).openapi()), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
