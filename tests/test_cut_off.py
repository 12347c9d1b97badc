"""A run that was cut off by a crash: what its guns kept is fetched once, said and sealed; the rest stays unknown."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import AsyncMock

import numpy as np

from cellctl.controller import Controller
from cellctl.cut_off import FETCH_S, Kept, give_up
from cellctl.orders import Order, OrderBook, Wanted
from cellctl.records.store import RunStore
from cellctl.records.verify import read_record, verify
from cellctl.stamps import VirtualStamps
from hal.clock import run_virtual
from hal.errors import NotConnected
from hal.interfaces import Band, TighteningResult, Trace
from tests.doubles import DoubleCell, event_log
from tests.records.world import header

ORDER = Order(Wanted("JO-1", "lpt_shaft_36", 1, "R-1", "S-1"), "run-1", "2000-01-01T00:00:00Z", None)


@dataclass
class Guns:
    """What their controllers kept, by gun; None: nothing. A gun that is not here does not answer."""

    results: dict[str, TighteningResult | None]
    asked: list[tuple[str, str]] = field(default_factory=list)

    async def kept(self, gun: str, key: str) -> TighteningResult | None:
        """See `cellctl.cut_off.Kept`."""
        self.asked.append((gun, key))
        if gun not in self.results:
            raise NotConnected("no link", device=gun)
        return self.results[gun]


def told(key: str) -> TighteningResult:
    """A result that is in its windows, with a long trace."""
    line = np.linspace(0.0, 1.0, 2000)
    return TighteningResult(key, "gun-1", 7, True, 36.04, 41.6, Band.OK, Band.OK, Trace(line, line, line), 1.0)


async def cut_off(data: Path, *commands: tuple[str, str, str]) -> None:
    """A run that ended after these intents (gun, command, key) and before whatever became of them."""
    run = await RunStore(data).begin(header(), VirtualStamps(1))
    for joint, (gun, command, key) in enumerate(commands):
        value = {"key": key, "device": gun, "command": command, "arguments": {"joint": joint}}
        await run.journal.append("intent", value)
    await run.journal.close()
    await run.blobs.close()


async def given_up(data: Path, kept: Kept) -> str:
    """What the operator reads; the record says the same and is whole."""
    controller, stamps = Controller(DoubleCell(), event_log(), safe_deadline_s=0.5), VirtualStamps(1, start=9)
    no = AsyncMock(side_effect=AssertionError)
    book = OrderBook(data / "orders.jsonl", controller, event_log(), stamps, check=no, open_session=no)
    store = RunStore(data)
    why = await give_up(ORDER, book, store, stamps, kept)
    summary = await store.get("run-1")
    assert (summary.state, summary.verdict, summary.reasons) == ("Aborted", "held", (why,))
    record = store.record_path("run-1")
    assert record is not None
    assert verify(record).ok
    return why


def test_what_guns_kept_is_fetched_and_sealed_and_nothing_is_done_again(tmp_path: Path) -> None:
    guns = Guns({"gun_a": told("a-1"), "gun_b": None})

    async def main() -> str:
        await cut_off(
            tmp_path, ("gun_a", "tighten", "a-1"), ("gun_b", "tighten", "b-1"), ("gun_feed", "move_to", "f-1")
        )
        return await given_up(tmp_path, guns.kept)

    why = run_virtual(main())
    assert sorted(guns.asked) == [("gun_a", "a-1"), ("gun_b", "b-1")]
    assert "gun_a had ended its program on joint 0: 36.0 Nm, 42 deg, OK" in why
    assert why.endswith("it is not known what became of: gun_b tighten, gun_feed move_to")
    rows = read_record(RunStore(tmp_path).folder_of("run-1") / "record.zip")[0]
    assert [row.value["result"]["key"] for row in rows if row.kind == "result" and row.value["result"]] == ["a-1"]


def test_a_gun_that_does_not_answer_holds_nothing_up(tmp_path: Path) -> None:
    async def hangs(gun: str, key: str) -> TighteningResult | None:
        await asyncio.sleep(1e6)
        return None

    async def main(kept: Kept) -> tuple[str, float]:
        await cut_off(tmp_path / kept.__name__, ("gun_a", "tighten", "a-1"))
        return await given_up(tmp_path / kept.__name__, kept), asyncio.get_running_loop().time()

    for kept in (hangs, Guns({}).kept):
        why, seconds = run_virtual(main(kept))
        assert why.endswith("it is not known what became of: gun_a tighten")
        assert seconds <= FETCH_S


def test_two_commands_of_one_gun_are_known_only_when_both_are(tmp_path: Path) -> None:
    async def kept(gun: str, key: str) -> TighteningResult | None:
        return told(key) if key == "a-1" else None

    async def main() -> str:
        await cut_off(tmp_path, ("gun_a", "tighten", "a-1"), ("gun_a", "tighten", "a-2"))
        return await given_up(tmp_path, kept)

    assert run_virtual(main()).endswith("OK; it is not known what became of: gun_a tighten")
