"""Job orders (ISA-95): one is worked on at a time, others wait in the MES. An order that was taken is kept on disk.

An idempotency key belongs to one body for ever: the same body gets the same order, another body is refused.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from cellctl.controller import Controller
from cellctl.event_log import EventLog
from cellctl.ports import Checkpoint, Progress
from cellctl.recipe import Recipe
from cellctl.session import Ending, Outcome, RunEnd, Session, Verdict
from cellctl.stamps import Stamps, rfc3339
from cellctl.states import Refused, State

OrderState = Literal["NotAllowedToStart", "AllowedToStart", "Running", "Interrupted", "Ended", "Aborted"]
RefusalCode = Literal["cell_not_idle", "job_order_exists", "idempotency_key_reused", "recipe_unknown", "recipe_unfit"]
PAUSED = frozenset({State.HOLDING, State.HELD, State.SUSPENDING, State.SUSPENDED})
ENDED: Mapping[Ending, OrderState] = {
    "complete": "Ended",
    "stopped": "Ended",
    "held": "Interrupted",
    "aborted": "Aborted",
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with an order. `pointer` is a JSON pointer into it."""

    pointer: str
    reason: str
    limit: str = ""
    unit: str = ""


class OrderRefused(Exception):
    """The order is not taken: `code` is stable."""

    def __init__(self, code: RefusalCode, reason: str, faults: tuple[Fault, ...] = ()) -> None:
        super().__init__(reason)
        self.code = code
        self.faults = faults


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the MES asks for."""

    job_order_id: str
    recipe: str
    recipe_version: int
    rotor_serial: str
    shaft_serial: str

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all fields: two bodies that ask for the same have the same."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Order:
    """An order that was taken, and its run. `received_utc` is RFC 3339. `ending` is None until the run has ended."""

    wanted: Wanted
    run_id: str
    received_utc: str
    key: str | None
    ending: Ending | None = None
    verdict: Verdict | None = None
    reasons: tuple[str, ...] = ()


OpenSession = Callable[[Order, Recipe], Awaitable[Session]]
CheckRecipe = Callable[[str, int], Recipe]
"""The recipe of that id and version; raises OrderRefused where there is none or where it does not fit the cell."""


class OrderBook:
    """All orders since the data folder was made."""

    def __init__(
        self,
        path: Path,
        controller: Controller,
        events: EventLog,
        stamps: Stamps,
        *,
        check: CheckRecipe,
        open_session: OpenSession,
    ) -> None:
        self._path = path
        self._controller = controller
        self._events = events
        self._stamps = stamps
        self._check = check
        self._open_session = open_session
        self._orders = _load(path)
        self._lock = asyncio.Lock()

    async def submit(self, wanted: Wanted, key: str | None) -> tuple[Order, bool]:
        """Take the order and start its run; true where it was taken before under the same key. Raises OrderRefused."""
        async with self._lock:
            known = self._known(wanted, key)
            if known is not None:
                return known, True
            recipe = self._check(wanted.recipe, wanted.recipe_version)
            if self._controller.state is not State.IDLE:
                raise OrderRefused("cell_not_idle", f"the cell is {self._controller.state}; orders are taken in Idle")
            order = Order(wanted, self._stamps.new_id("run"), rfc3339(self._stamps.now()), key)
            session = _Booked(await self._open_session(order, recipe), self._ended)
            await self._append({"order": asdict(order)})
            try:
                self._controller.start(session)
            except Refused as refused:
                await self._append({"withdrawn": order.run_id})
                raise OrderRefused("cell_not_idle", f"the cell is {refused.state}; orders are taken in Idle") from None
            self._orders[order.wanted.job_order_id] = order
            self._events.publish("job_order", {"job_order_id": wanted.job_order_id, "run_id": order.run_id})
            return order, False

    def get(self, job_order_id: str) -> Order | None:
        """The order of that id."""
        return self._orders.get(job_order_id)

    def all(self) -> list[Order]:
        """Every order, newest first."""
        return list(reversed(self._orders.values()))

    def of_run(self, run_id: str) -> Order | None:
        """The order that the run belongs to."""
        return next((order for order in self._orders.values() if order.run_id == run_id), None)

    def state(self, order: Order) -> OrderState:
        """ISA-95 state of the order now."""
        if order.ending is not None:
            return ENDED[order.ending]
        if self._controller.snapshot().run_id != order.run_id:
            return "Interrupted"  # the service ended while it ran
        return "Interrupted" if self._controller.state in PAUSED else "Running"

    def interrupted(self) -> Order | None:
        """The order that was running when the service ended without unwinding it, if any."""
        return next((order for order in self.all() if order.ending is None), None)

    async def give_up(self, order: Order) -> None:
        """Write down that an interrupted order was ended by nobody."""
        await self._ended(order.run_id, RunEnd("aborted", Outcome("held", ("the service ended during the run",))))

    def _known(self, wanted: Wanted, key: str | None) -> Order | None:
        if key is not None:
            for order in self._orders.values():
                if order.key == key:
                    if order.wanted.fingerprint != wanted.fingerprint:
                        raise OrderRefused("idempotency_key_reused", "this Idempotency-Key came with another body")
                    return order
        if wanted.job_order_id in self._orders:
            raise OrderRefused("job_order_exists", f"job order {wanted.job_order_id} was taken before")
        return None

    async def _ended(self, run_id: str, end: RunEnd) -> None:
        outcome = end.outcome
        order = self.of_run(run_id)
        if order is not None:
            ended = replace(order, ending=end.ending, verdict=outcome.verdict, reasons=outcome.reasons)
            self._orders[order.wanted.job_order_id] = ended
        told = {"run_id": run_id, "ending": end.ending, "verdict": outcome.verdict, "reasons": list(outcome.reasons)}
        await self._append({"ended": told})
        self._events.publish("run_ended", told)

    async def _append(self, line: Mapping[str, object]) -> None:
        text = json.dumps(line, sort_keys=True) + "\n"
        await asyncio.get_running_loop().run_in_executor(None, _write, self._path, text)


class _Booked:
    """A session whose end is written into the book, after its record is closed, even where that failed."""

    def __init__(self, session: Session, ended: Callable[[str, RunEnd], Any]) -> None:
        self._session = session
        self._ended = ended

    @property
    def run_id(self) -> str:
        return self._session.run_id

    @property
    def job_order_id(self) -> str:
        return self._session.job_order_id

    async def prepare(self) -> None:
        await self._session.prepare()

    async def execute(self, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        return await self._session.execute(checkpoint, progress)

    async def close(self, end: RunEnd) -> None:
        try:
            await self._session.close(end)
        finally:
            await self._ended(self.run_id, end)


def _write(path: Path, text: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _load(path: Path) -> dict[str, Order]:
    """Orders by id. A last line that a crash tore is left out: it was never answered."""
    orders: dict[str, Order] = {}
    if not path.exists():
        return orders
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if "order" in line:
            fields = line["order"]
            order = Order(**(fields | {"wanted": Wanted(**fields["wanted"]), "reasons": ()}))
            orders[order.wanted.job_order_id] = order
        run_id = line.get("withdrawn") or line.get("ended", {}).get("run_id")
        for name in [name for name, order in orders.items() if order.run_id == run_id]:
            if "ended" in line:
                told = line["ended"]
                reasons = tuple(told["reasons"])
                orders[name] = replace(orders[name], ending=told["ending"], verdict=told["verdict"], reasons=reasons)
            else:
                del orders[name]
    return orders
