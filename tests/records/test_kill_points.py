"""Crash at every commit and command point, the gun living on: nothing acknowledged lost, nothing done twice.

Ledgers with one rule broken must be caught by the same harness, or it proves nothing.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from cellctl.records.blobs import HashOnly
from cellctl.records.chain import Row
from cellctl.records.journal import Journal, open_intents, read_rows
from cellctl.records.ledger import JournalLedger
from cellctl.stamps import VirtualStamps
from hal.clock import run_virtual

JOINTS = 4


class PowerOff(BaseException):
    """The controller is gone from one instruction to the next."""


class Bomb:
    """Goes off at the n-th point that it is shown."""

    def __init__(self, fuse: int) -> None:
        self.left = fuse

    def point(self) -> None:
        self.left -= 1
        if self.left == 0:
            raise PowerOff


class Gun:
    """Outlives the controller; stores results by key."""

    def __init__(self) -> None:
        self.results: dict[str, int] = {}
        self.tightened: Counter[int] = Counter()

    def tighten(self, key: str, joint: int) -> int:
        self.tightened[joint] += 1
        self.results[key] = joint
        return joint


class NoIntent(JournalLedger):
    """Sends first, writes afterwards."""

    async def act(self, device: str, command: str, arguments: Mapping[str, object], do: Callable[[str], Any]) -> Any:
        key = self._stamps.new_id(device)
        result = await do(key)
        await self._journal.append("intent", {"key": key, "arguments": dict(arguments)})
        await self._journal.append("result", {"key": key, "result": result})
        return result


class EarlyAcknowledge(JournalLedger):
    """Answers before the result is on disk."""

    async def act(self, device: str, command: str, arguments: Mapping[str, object], do: Callable[[str], Any]) -> Any:
        key = self._stamps.new_id(device)
        await self._journal.append("intent", {"key": key, "arguments": dict(arguments)})
        result = await do(key)
        self.late = asyncio.ensure_future(self._journal.append("result", {"key": key, "result": result}))
        return result


class NoKey(JournalLedger):
    """Does not tell the device under which key it acts."""

    async def act(self, device: str, command: str, arguments: Mapping[str, object], do: Callable[[str], Any]) -> Any:
        return await super().act(device, command, arguments, lambda key: do(f"nameless-{key[:3]}"))


def hindered(journal: Journal, bomb: Bomb) -> Journal:
    """A journal that shows every commit to the bomb, before and after."""
    commit = journal._commit

    def shown(rows: list[Row]) -> None:
        bomb.point()
        commit(rows)
        bomb.point()

    journal._commit = shown  # type: ignore[method-assign]
    return journal


async def controller(
    path: Path, kind: type[JournalLedger], gun: Gun, bomb: Bomb, start: int, acknowledged: list[int]
) -> None:
    """Tighten what is not tight yet. After a crash the gun is asked for what is open, and only by its key."""
    stamps = VirtualStamps(1, start=start)
    journal = await Journal.open(path, stamps)
    try:
        for intent in open_intents(await journal.rows()):
            key = intent.value["key"]
            if key in gun.results:
                await journal.append("result", {"key": key, "result": gun.results[key]})
            else:
                await journal.append("cancelled", {"key": key, "outcome": "not_sent"})
        done = {row.value["result"] for row in await journal.rows() if row.kind == "result"}
        ledger = kind(hindered(journal, bomb), HashOnly(), stamps)
        for joint in range(JOINTS):
            if joint not in done:
                await ledger.act("gun_a", "tighten", {"joint": joint}, command(gun, bomb, joint))
                acknowledged.append(joint)
                bomb.point()
                await asyncio.sleep(0.0)
    finally:
        journal._database.close()


def command(gun: Gun, bomb: Bomb, joint: int) -> Callable[[str], Awaitable[int]]:
    async def do(key: str) -> int:
        bomb.point()
        result = gun.tighten(key, joint)
        bomb.point()
        return result

    return do


def broken_rules(folder: Path, kind: type[JournalLedger]) -> set[str]:
    """Every rule that is broken when a controller with that ledger is crashed at each point in turn."""
    broken: set[str] = set()
    for fuse in range(1, 200):
        path = folder / f"{kind.__name__}-{fuse}.sqlite"
        gun, acknowledged = Gun(), list[int]()
        try:
            run_virtual(controller(path, kind, gun, Bomb(fuse), 0, acknowledged))
            return broken
        except PowerOff:
            written = {row.value["result"] for row in read_rows(path) if row.kind == "result"}
        if not set(acknowledged) <= written:
            broken.add("acknowledged and lost")
        run_virtual(controller(path, kind, gun, Bomb(0), 1, acknowledged))
        if any(times > 1 for times in gun.tightened.values()):
            broken.add("done twice")
        if set(gun.tightened) != set(range(JOINTS)):
            broken.add("not done")
    raise AssertionError("the controller never came to its end")


def test_no_crash_loses_or_repeats_anything(tmp_path: Path) -> None:
    assert broken_rules(tmp_path, JournalLedger) == set()


@pytest.mark.parametrize(
    ("kind", "caught"),
    [(NoIntent, "done twice"), (EarlyAcknowledge, "acknowledged and lost"), (NoKey, "done twice")],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_harness_catches_a_ledger_with_a_broken_rule(
    tmp_path: Path, kind: type[JournalLedger], caught: str
) -> None:
    assert caught in broken_rules(tmp_path, kind)
