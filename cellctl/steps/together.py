"""Two things at once, of which neither is cut short because the other failed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any, TypeVar, cast

A = TypeVar("A")
B = TypeVar("B")


async def all_together(*each: Awaitable[A]) -> list[A]:
    """As `together`, of any number of things that give the same."""
    done = await asyncio.gather(*each, return_exceptions=True)
    if errors := [one for one in done if isinstance(one, BaseException)]:
        raise errors[0]
    return [one for one in done if not isinstance(one, BaseException)]


async def together(first: Awaitable[A], second: Awaitable[B]) -> tuple[A, B]:
    """Await both to their ends, then raise the first error, if any. Cancelling it cancels both.

    A gun that is tightening must not be torn off because its opposite reported an error: its result would be lost.
    """
    one, other = await all_together(*cast(tuple[Awaitable[Any], Awaitable[Any]], (first, second)))
    return one, other
