import asyncio
import sqlite3
import threading
from pathlib import Path

import pytest

from cellctl.records.chain import GENESIS, head_of, link, row_of_line
from cellctl.records.errors import JournalUnavailable, RecordCorrupt
from cellctl.records.journal import Journal, open_intents, read_rows
from cellctl.stamps import VirtualStamps
from hal.clock import run_virtual


async def written(path: Path | None, count: int = 5) -> str:
    journal = await Journal.open(path, VirtualStamps(1))
    for number in range(count):
        await asyncio.sleep(1.0)
        await journal.append("fact", {"number": number})
    await journal.close()
    return journal.head


def test_rows_carry_time_kind_payload_and_chain(tmp_path: Path) -> None:
    head = run_virtual(written(tmp_path / "j.sqlite"))
    rows = read_rows(tmp_path / "j.sqlite")
    assert [row.seq for row in rows] == [1, 2, 3, 4, 5]
    assert [row.time_s for row in rows] == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert rows[2].utc == "2000-01-01T00:00:03.000000Z"
    assert rows[2].value == {"number": 2}
    assert rows[0].prev == GENESIS
    assert rows[-1].hash == head == head_of(rows)


def test_a_closed_journal_is_one_file_though_it_is_read(tmp_path: Path) -> None:
    run_virtual(written(tmp_path / "j.sqlite"))
    assert len(read_rows(tmp_path / "j.sqlite")) == 5
    assert [path.name for path in tmp_path.iterdir()] == ["j.sqlite"]


def test_file_and_memory_give_the_same_hash(tmp_path: Path) -> None:
    assert run_virtual(written(tmp_path / "j.sqlite")) == run_virtual(written(None))
    assert run_virtual(written(None, 4)) != run_virtual(written(None, 5))


def test_the_file_is_synced_on_every_commit(tmp_path: Path) -> None:
    async def main() -> tuple[str, int]:
        journal = await Journal.open(tmp_path / "j.sqlite", VirtualStamps(1))
        try:
            (mode,) = journal._database.execute("PRAGMA journal_mode").fetchone()
            (synchronous,) = journal._database.execute("PRAGMA synchronous").fetchone()
            return mode, synchronous
        finally:
            await journal.close()

    assert run_virtual(main()) == ("wal", 2)


@pytest.mark.parametrize("statement", ["UPDATE journal SET kind='x'", "DELETE FROM journal WHERE seq=5"])
def test_rows_cannot_be_changed_by_accident(tmp_path: Path, statement: str) -> None:
    run_virtual(written(tmp_path / "j.sqlite"))
    database = sqlite3.connect(tmp_path / "j.sqlite")
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        database.execute(statement)
    database.close()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE journal SET payload=replace(payload, '2', '7') WHERE seq=3",
        "UPDATE journal SET payload=payload || ' ' WHERE seq=3",
        "UPDATE journal SET time_s=time_s+1e-9 WHERE seq=3",
        "UPDATE journal SET utc=replace(utc, '2000', '2001') WHERE seq=3",
        "UPDATE journal SET kind='result' WHERE seq=1",
        "UPDATE journal SET hash=prev WHERE seq=5",
        "DELETE FROM journal WHERE seq=2",
        "DELETE FROM journal WHERE seq=1",
    ],
)
def test_every_byte_is_in_the_chain(tmp_path: Path, statement: str) -> None:
    path = tmp_path / "j.sqlite"
    run_virtual(written(path))
    database = sqlite3.connect(path)
    database.executescript("DROP TRIGGER journal_no_update; DROP TRIGGER journal_no_delete;")
    assert database.execute(statement).rowcount == 1
    database.commit()
    database.close()
    with pytest.raises(RecordCorrupt, match="row"):
        run_virtual(Journal.open(path, VirtualStamps(1)))


def test_reopening_goes_on_with_the_chain(tmp_path: Path) -> None:
    async def again() -> int:
        journal = await Journal.open(tmp_path / "j.sqlite", VirtualStamps(1, start=1))
        await journal.append("fact", {"number": 5})
        await journal.close()
        return journal.count

    run_virtual(written(tmp_path / "j.sqlite"))
    assert run_virtual(again()) == 6
    head_of(read_rows(tmp_path / "j.sqlite"))


def test_another_schema_and_another_file_are_refused(tmp_path: Path) -> None:
    run_virtual(written(tmp_path / "j.sqlite"))
    database = sqlite3.connect(tmp_path / "j.sqlite")
    database.execute("PRAGMA user_version=2")
    database.close()
    with pytest.raises(RecordCorrupt, match="schema 2"):
        run_virtual(Journal.open(tmp_path / "j.sqlite", VirtualStamps(1)))
    (tmp_path / "text").write_text("this is no database, and long enough to be looked at" * 50)
    with pytest.raises(RecordCorrupt, match="not a journal"):
        run_virtual(Journal.open(tmp_path / "text", VirtualStamps(1)))
    with pytest.raises(JournalUnavailable):
        run_virtual(Journal.open(tmp_path / "no" / "folder", VirtualStamps(1)))


@pytest.mark.parametrize("obstacle", ["max_page_count=1", "query_only=ON"])
def test_a_full_or_read_only_disk_is_told_and_nothing_is_lost(tmp_path: Path, obstacle: str) -> None:
    async def main() -> tuple[int, str]:
        journal = await Journal.open(tmp_path / "j.sqlite", VirtualStamps(1))
        await journal.append("fact", 1)
        head = journal.head
        journal._database.execute(f"PRAGMA {obstacle}")
        with pytest.raises(JournalUnavailable, match="cannot be written"):
            await journal.append("fact", "x" * 100_000)
        assert journal.head == head
        journal._database.execute("PRAGMA max_page_count=1000000")
        journal._database.execute("PRAGMA query_only=OFF")
        await journal.append("fact", 2)
        await journal.close()
        return journal.count, journal.head

    count, head = run_virtual(main())
    rows = read_rows(tmp_path / "j.sqlite")
    assert [row.value for row in rows] == [1, 2]
    assert (count, head) == (2, head_of(rows))


def test_a_slow_disk_does_not_hold_the_loop_and_waiting_rows_share_a_commit(tmp_path: Path) -> None:
    async def main() -> tuple[int, int, list[int]]:
        journal = await Journal.open(tmp_path / "j.sqlite", VirtualStamps(1))
        commits: list[int] = []
        slow, commit = threading.Event(), journal._commit

        def hindered(rows: list) -> None:
            slow.wait(5.0)
            commits.append(len(rows))
            commit(rows)

        journal._commit = hindered  # type: ignore[method-assign]
        appends = [asyncio.create_task(journal.append("fact", number)) for number in range(20)]
        turns = 0
        for _ in range(50):
            await asyncio.sleep(0)
            turns += 1
        done_early = sum(task.done() for task in appends)
        slow.set()
        rows = await asyncio.gather(*appends)
        await journal.close()
        assert [row.value for row in rows] == list(range(20))
        return turns, done_early, commits

    turns, done_early, commits = asyncio.run(main())
    assert (turns, done_early) == (50, 0)
    assert sum(commits) == 20
    assert len(commits) < 20
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("journal")]


def test_a_cancelled_append_is_finished(tmp_path: Path) -> None:
    async def main() -> None:
        journal = await Journal.open(tmp_path / "j.sqlite", VirtualStamps(1))
        slow, commit = threading.Event(), journal._commit

        def hindered(rows: list) -> None:
            slow.wait(5.0)
            commit(rows)

        journal._commit = hindered  # type: ignore[method-assign]
        task = asyncio.create_task(journal.append("fact", "begun"))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        slow.set()
        await journal.close()

    asyncio.run(main())
    assert [row.value for row in read_rows(tmp_path / "j.sqlite")] == ["begun"]


def test_a_closed_journal_refuses_and_leaves_no_thread() -> None:
    async def main() -> None:
        journal = await Journal.open(None, VirtualStamps(1))
        await journal.append("fact", 1)
        await journal.close()
        await journal.close()
        with pytest.raises(JournalUnavailable, match="closed"):
            await journal.append("fact", 2)

    before = threading.active_count()
    asyncio.run(main())
    assert threading.active_count() == before


def test_an_export_is_the_journal(tmp_path: Path) -> None:
    async def main() -> str:
        journal = await Journal.open(None, VirtualStamps(1))
        await journal.append("fact", 1)
        await journal.export(tmp_path / "copy.sqlite")
        await journal.close()
        return journal.head

    assert run_virtual(main()) == head_of(read_rows(tmp_path / "copy.sqlite"))

    async def again() -> str:
        journal = await Journal.open(tmp_path / "copy.sqlite", VirtualStamps(1))
        await journal.close()
        return journal.head

    assert run_virtual(again()) == head_of(read_rows(tmp_path / "copy.sqlite"))


def test_lines_of_an_export_are_canonical_to_the_byte() -> None:
    row = link(1, 0.5, "2000-01-01T00:00:00.500000Z", "fact", '{"a":1.5}', GENESIS)
    assert row_of_line(row.line()) == row
    line = row.line()
    for changed in (line + " ", line.replace("1.5", "1.50"), line.replace("0.5", "1"), "{}", "[]", ""):
        with pytest.raises(RecordCorrupt):
            row_of_line(changed)


def test_open_intents_are_those_without_outcome() -> None:
    async def main() -> list[str]:
        journal = await Journal.open(None, VirtualStamps(1))
        for key, outcome in (("a", "result"), ("b", "error"), ("c", "cancelled"), ("d", None)):
            await journal.append("intent", {"key": key})
            if outcome:
                await journal.append(outcome, {"key": key})
        rows = await journal.rows()
        await journal.close()
        return [row.value["key"] for row in open_intents(rows)]

    assert run_virtual(main()) == ["d"]
