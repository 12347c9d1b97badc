"""A run that was cut off when the service ended: what guns still know of it is fetched, then its record is sealed.

Nothing is ever done again for it: a result that a gun's controller kept tells what became of a command, and without one
that stays unknown.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import groupby

from cellctl.orders import Order, OrderBook
from cellctl.records.chain import Row
from cellctl.records.errors import RecordError, UnknownRun
from cellctl.records.ledger import JournalLedger
from cellctl.records.store import RunStore
from cellctl.records.summary import RunEnded
from cellctl.stamps import Stamps
from hal.errors import CellError
from hal.interfaces import TighteningResult

Kept = Callable[[str, str], Awaitable[TighteningResult | None]]
"""What the gun of that name kept under that key. Raises CellError."""
FETCH_S = 2.0
"""Asking one gun may take so long: the cell is to say within seconds how it stands."""


async def give_up(order: Order, orders: OrderBook, store: RunStore, stamps: Stamps, kept: Kept) -> str:
    """Seal what is left of a run that was cut off; the sentence that the operator reads."""
    why = f"the service ended during run {order.run_id}"
    try:
        opened, unknown = await store.resume(order.run_id, stamps)
    except UnknownRun:
        pass  # it was cut off before its journal was begun
    except RecordError as error:
        why = f"{why}; its journal cannot be read: {error.reason}"
    else:
        fetched = await _fetched(opened.ledger, unknown, kept)
        told = [said for row in unknown if (said := fetched.get(str(row.value["key"])))]
        lost = sorted({f"{row.value['device']} {row.value['command']}" for row in unknown} - _settled(unknown, fetched))
        why = "; ".join([why, *told, *([f"it is not known what became of: {', '.join(lost)}"] if lost else [])])
        await opened.end(RunEnded("Aborted", "held", (why,)))
    await orders.give_up(order)
    return why


def _settled(unknown: tuple[Row, ...], fetched: dict[str, str]) -> set[str]:
    """Devices and commands of which everything is known by now."""
    named = sorted(unknown, key=_name)
    return {name for name, rows in groupby(named, _name) if all(str(row.value["key"]) in fetched for row in rows)}


def _name(row: Row) -> str:
    return f"{row.value['device']} {row.value['command']}"


async def _fetched(ledger: JournalLedger, unknown: tuple[Row, ...], kept: Kept) -> dict[str, str]:
    """What guns say of tightenings that nobody waited for, in words, by key; all guns are asked at once."""
    rows = [row for row in unknown if row.value["command"] == "tighten"]
    said = await asyncio.gather(*(_ask(ledger, row, kept) for row in rows))
    return {str(row.value["key"]): words for row, words in zip(rows, said, strict=True) if words}


async def _ask(ledger: JournalLedger, row: Row, kept: Kept) -> str:
    device, key = str(row.value["device"]), str(row.value["key"])
    try:
        async with asyncio.timeout(FETCH_S):
            result = await ledger.act(device, "result", {"key": key}, lambda _: kept(device, key))
    except (CellError, TimeoutError):
        return ""
    if result is None:
        return ""
    joint, word = row.value["arguments"]["joint"], "OK" if result.ok else "NOK"
    reached = f"{result.torque_nm:.1f} Nm, {result.angle_deg:.0f} deg, {word}"
    return f"{device} had ended its program on joint {joint}: {reached}"
