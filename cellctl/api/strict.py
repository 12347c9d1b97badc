"""Bodies are read strictly: UTF-8 JSON without duplicate keys and without numbers that are not finite."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute

from cellctl.api.problems import ProblemError, Violation


class _Unfit(ValueError):
    """JSON that is well-formed and still not taken."""


def parse(body: bytes) -> Any:
    """The JSON value of `body`. Raises ProblemError 422 with the place."""
    try:
        return json.loads(
            body.decode("utf-8"), object_pairs_hook=_unique, parse_constant=_constant, parse_float=_finite
        )
    except json.JSONDecodeError as error:
        raise _refused(f"not JSON: {error.msg} at line {error.lineno}, column {error.colno}") from None
    except UnicodeDecodeError as error:
        raise _refused(f"not UTF-8 at byte {error.start}") from None
    except RecursionError:
        raise _refused("nested too deeply") from None
    except ValueError as error:
        raise _refused(str(error)) from None


def _refused(reason: str) -> ProblemError:
    return ProblemError(422, "invalid_json", reason, violations=[Violation(pointer="", reason=reason)])


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        seen: set[str] = set()
        double = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise _Unfit(f"key {double!r} stands twice")
    return value


def _constant(name: str) -> float:
    raise _Unfit(f"{name} is not a number that JSON knows")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise _Unfit(f"{text} is not finite")
    return value


class StrictRequest(Request):
    """A request whose JSON is parsed strictly."""

    async def json(self) -> Any:
        """See `parse`."""
        return parse(await self.body())


class StrictRoute(APIRoute):
    """A route that reads its body through `StrictRequest`."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The handler, given a strict request."""
        handle = super().get_route_handler()

        async def strictly(request: Request) -> Response:
            return await handle(StrictRequest(request.scope, request.receive))

        return strictly
