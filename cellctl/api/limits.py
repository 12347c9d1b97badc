"""Limits on what a client may send: size of the body, and the time it may take to send it."""

from __future__ import annotations

import asyncio

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cellctl.api.problems import Problem, answer, title_of

MAX_BODY_BYTES = 1_000_000
DISCARD_BYTES = 32_000_000
"""A body that is too large is read and thrown away up to here, so that the client hears the answer; it is hung up on
beyond that."""


class BodyLimits:
    """ASGI middleware: reads the whole body before the app is asked, within `read_limit_s` of the loop's time."""

    def __init__(self, app: ASGIApp, *, read_limit_s: float) -> None:
        self._app = app
        self._read_limit_s = read_limit_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            async with asyncio.timeout(self._read_limit_s):
                body, size = await _read(receive)
        except TimeoutError:
            await _refuse(scope, receive, send, 408, "body_late", "the body did not arrive in time")
            return
        if body is None:
            return  # the client has gone: nobody is left to answer
        if size > MAX_BODY_BYTES:
            detail = f"the body is larger than {MAX_BODY_BYTES} bytes"
            await _refuse(scope, receive, send, 413, "body_too_large", detail)
            return
        await self._app(scope, _replay(body, receive), send)


async def _read(receive: Receive) -> tuple[bytes | None, int]:
    """The body and its size; of a body that is too large only the size counts. None where the client went away."""
    chunks: list[bytes] = []
    size = 0
    more = True
    while more and size <= DISCARD_BYTES:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None, size
        chunk = message.get("body", b"")
        size += len(chunk)
        if size <= MAX_BODY_BYTES:
            chunks.append(chunk)
        more = message.get("more_body", False)
    return b"".join(chunks), size


def _replay(body: bytes, receive: Receive) -> Receive:
    told = False

    async def again() -> Message:
        nonlocal told
        if told:
            return await receive()
        told = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, code: str, detail: str) -> None:
    problem = Problem(title=title_of(status), status=status, detail=detail, code=code)
    response = answer(Request(scope), problem, {"Connection": "close"})
    await response(scope, receive, send)
