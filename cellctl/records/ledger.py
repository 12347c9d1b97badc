"""The one place where anything that acts is written down. Implements `cellctl.ports.Ledger`.

Order of rows for one command: ``intent`` with its key, durable before the command is sent; then one of ``result``,
``error`` or ``cancelled``, durable before the caller hears of it (that is the acknowledgement). An intent without any
of them is a command of which nothing is known: it is never repeated unasked. Nothing is swallowed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import is_dataclass
from typing import Any, TypeVar

from numpy.typing import NDArray

from cellctl.records.blobs import Blobs, is_scan
from cellctl.records.canonical import Plain, array_as_list, plain_of
from cellctl.records.journal import Journal
from cellctl.stamps import Stamps
from hal.errors import CellError

R = TypeVar("R")

INLINE_ELEMENTS = 512
"""Arrays up to this many elements stand in the row itself, larger ones in a blob that the row names."""


class JournalLedger:
    """Ledger on a journal and a blob store."""

    def __init__(self, journal: Journal, blobs: Blobs, stamps: Stamps) -> None:
        self._journal = journal
        self._blobs = blobs
        self._stamps = stamps

    async def act(
        self, device: str, command: str, arguments: Mapping[str, object], do: Callable[[str], Awaitable[R]]
    ) -> R:
        """Intent, command, result. Raises what the command raised, after it is written.

        JournalUnavailable before the command means that it was not sent; after it, that its outcome is open.
        """
        key = self._stamps.new_id(device)
        head = {"key": key, "device": device, "command": command}
        try:
            await finished(self._write("intent", head | {"arguments": dict(arguments)}, device))
        except asyncio.CancelledError:
            await finished(self._journal.append("cancelled", head | {"outcome": "not_sent"}))
            raise
        try:
            result = await do(key)
        except asyncio.CancelledError:
            await finished(self._journal.append("cancelled", head | {"outcome": "unknown"}))
            raise
        except Exception as error:
            await finished(self._journal.append("error", head | error_of(error)))
            raise
        await finished(self._write("result", head | {"result": result}, device))
        return result

    async def note(self, kind: str, value: object) -> None:
        """A fact. A frozen dataclass keeps the name of its class beside its fields, as ``$type``."""
        named = {"$type": type(value).__name__} if is_dataclass(value) else {}
        plain = await self._plain(value, kind)
        await self._journal.append(kind, named | plain if named else plain)

    async def blob(self, kind: str, arrays: Mapping[str, NDArray[Any]]) -> str:
        """Arrays by content hash; the hash is journalled once the blob is durable."""
        digest = await self._blobs.put(arrays, scan=is_scan(kind))
        await self._journal.append("blob", {"kind": kind, "blob": digest})
        return digest

    async def _write(self, kind: str, value: object, device: str) -> None:
        await self._journal.append(kind, await self._plain(value, device))

    async def _plain(self, value: object, owner: str) -> Any:
        """`value` as JSON; large arrays are put aside first, a camera's as scans."""
        large: list[tuple[dict[str, Plain], str, NDArray[Any]]] = []

        def aside(name: str, array: NDArray[Any]) -> Plain:
            if array.size <= INLINE_ELEMENTS:
                return array_as_list(name, array)
            reference: dict[str, Plain] = {"name": name, "shape": list(array.shape), "dtype": array.dtype.str}
            large.append((reference, name, array))
            return reference

        plain = plain_of(value, aside)
        for reference, name, array in large:
            reference["blob"] = await self._blobs.put({name: array}, scan=is_scan(owner))
        return plain


async def finished(write: Coroutine[Any, Any, R]) -> R:
    """Await `write` to its end even when cancelled meanwhile; the cancellation is raised after it.

    What the cell did is known at that moment and nowhere else: it must reach the disk.
    """
    task = asyncio.ensure_future(write)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError as error:
            cancelled = error
        except Exception:
            break
    result = task.result()
    if cancelled is not None:
        raise cancelled
    return result


def error_of(error: BaseException) -> dict[str, Any]:
    """What is written of an error: its stable code, device, reason; the class name where it has no code."""
    if isinstance(error, CellError):
        return {
            "code": error.code,
            "reason": error.reason if hasattr(error, "reason") else str(error),
            "device_named": getattr(error, "device", ""),
            "retryable": error.retryable,
        }
    return {"code": "unexpected", "reason": f"{type(error).__name__}: {error}", "device_named": "", "retryable": False}
