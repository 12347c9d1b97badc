"""Serves the operator's page: three static files and nothing else. All that it shows comes through the API."""

from __future__ import annotations

from importlib.resources import files
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Path, Response

from cellctl.api.auth import Public

router = APIRouter()
TYPES = {"css": "text/css; charset=utf-8", "js": "text/javascript; charset=utf-8", "svg": "image/svg+xml"}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


@router.get("/", dependencies=[Depends(Public())])
async def index() -> Response:
    """The page."""
    return Response(_read("index.html"), media_type="text/html; charset=utf-8", headers=HEADERS)


@router.get("/page/{name}", dependencies=[Depends(Public())])
async def asset(name: Annotated[Literal["page.css", "page.js", "api.js", "bolts.js", "icon.svg"], Path()]) -> Response:
    """A file of the page."""
    return Response(_read(name), media_type=TYPES[name.rsplit(".", 1)[1]], headers=HEADERS)


def _read(name: str) -> bytes:
    return files("cellctl.hmi").joinpath("static").joinpath(name).read_bytes()
