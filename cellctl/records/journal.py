"""The journal: append-only, hash-chained SQLite, one writer thread, an append returns after its commit.

WAL with synchronous=FULL: with NORMAL a power cut loses acknowledged rows. Appends that wait together are committed
together. ":memory:" gives the same rows and hashes without a file, for studies.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sqlite3
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cellctl.records.canonical import canonical
from cellctl.records.chain import GENESIS, SCHEMA, Row, head_of, link
from cellctl.records.errors import JournalUnavailable, RecordCorrupt
from cellctl.stamps import Stamps, rfc3339
from hal.clock import standing_still

T = TypeVar("T")

TABLE = """
CREATE TABLE journal (
    seq INTEGER PRIMARY KEY, time_s REAL NOT NULL, utc TEXT NOT NULL, kind TEXT NOT NULL,
    payload TEXT NOT NULL, prev TEXT NOT NULL, hash TEXT NOT NULL
) STRICT;
CREATE TRIGGER journal_no_update BEFORE UPDATE ON journal BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;
CREATE TRIGGER journal_no_delete BEFORE DELETE ON journal BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;
"""
COLUMNS = "seq, time_s, utc, kind, payload, prev, hash"


@dataclass(frozen=True, slots=True)
class _Pending:
    time_s: float
    utc: str
    kind: str
    payload: str
    done: asyncio.Future[Row]


class Journal:
    """One journal. Made by `open`; `close` leaves no thread behind."""

    def __init__(self, database: sqlite3.Connection, executor: ThreadPoolExecutor, stamps: Stamps, last: Row | None):
        self._database = database
        self._executor = executor
        self._stamps = stamps
        self._pending: deque[_Pending] = deque()
        self._head, self._count = (last.hash, last.seq) if last else (GENESIS, 0)
        self._closed = False

    @classmethod
    async def open(cls, path: Path | None, stamps: Stamps, *, durable: bool = True) -> Journal:
        """Open or create the journal at `path` (None: in memory) and check its whole chain.

        Not `durable`: nothing waits for the disk. For runs in virtual time, which move no metal and can be repeated.

        Raises RecordCorrupt where the chain is broken, JournalUnavailable where the file cannot be opened.
        """
        executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        try:
            database, last = await asyncio.get_running_loop().run_in_executor(executor, _open, path, durable)
        except BaseException:
            executor.shutdown(wait=False)
            raise
        return cls(database, executor, stamps, last)

    @property
    def head(self) -> str:
        """Hash of the last row: the journal's hash."""
        return self._head

    @property
    def count(self) -> int:
        """Number of rows."""
        return self._count

    async def append(self, kind: str, value: object) -> Row:
        """Write one row and return it once it is durable. An append that was begun is finished, cancelled or not.

        Raises JournalUnavailable when nothing was written, TypeError for a value without canonical form.
        """
        if self._closed:
            raise JournalUnavailable("the journal is closed")
        loop = asyncio.get_running_loop()
        stamps = self._stamps
        pending = _Pending(stamps.cell_time_s(), rfc3339(stamps.now()), kind, canonical(value), loop.create_future())
        self._pending.append(pending)
        job = loop.run_in_executor(self._executor, self._write)
        job.add_done_callback(_settle)
        with standing_still():  # a quickened clock must not count what the disk takes
            return await asyncio.shield(pending.done)

    async def rows(self, *, after: int = 0, limit: int = -1) -> tuple[Row, ...]:
        """Rows with a sequence number above `after`, at most `limit` of them (-1: all)."""
        query = f"SELECT {COLUMNS} FROM journal WHERE seq > ? ORDER BY seq LIMIT ?"
        return await self._run(lambda: _rows(self._database, query, (after, limit)))

    async def export(self, path: Path) -> None:
        """Write the whole journal to a new file, durable when this returns."""
        await self._run(lambda: _copy(self._database, path))

    async def close(self) -> None:
        """Finish what was begun, close the file, end the thread. May be called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(self._executor, _close, self._database))
        finally:
            self._executor.shutdown(wait=True)

    async def _run(self, job: Callable[[], T]) -> T:
        if self._closed:
            raise JournalUnavailable("the journal is closed")
        return await asyncio.get_running_loop().run_in_executor(self._executor, job)

    def _write(self) -> list[tuple[_Pending, Row | BaseException]]:
        """In the writer thread: everything that waits goes into one transaction, or none of it."""
        batch = [self._pending.popleft() for _ in range(len(self._pending))]
        if not batch:
            return []
        rows: list[Row] = []
        head, count = self._head, self._count
        try:
            for item in batch:
                row = link(count + 1, item.time_s, item.utc, item.kind, item.payload, head)
                rows.append(row)
                head, count = row.hash, row.seq
            self._commit(rows)
        except Exception as error:  # whatever it is, nobody may wait for ever for a row that is not written
            return [(item, JournalUnavailable(f"the journal cannot be written: {error}")) for item in batch]
        self._head, self._count = head, count
        return list(zip(batch, rows, strict=True))

    def _commit(self, rows: list[Row]) -> None:
        values = [(row.seq, row.time_s, row.utc, row.kind, row.payload, row.prev, row.hash) for row in rows]
        try:
            self._database.execute("BEGIN IMMEDIATE")
            self._database.executemany(f"INSERT INTO journal ({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)", values)
            self._database.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                self._database.execute("ROLLBACK")
            raise


def read_rows(path: Path, *, after: int = 0, limit: int = -1) -> tuple[Row, ...]:
    """Rows of a journal that someone else may be writing, by a connection of its own. Blocking."""
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            query = f"SELECT {COLUMNS} FROM journal WHERE seq > ? ORDER BY seq LIMIT ?"
            return _rows(database, query, (after, limit))
    except sqlite3.DatabaseError as error:
        raise RecordCorrupt(f"{path.name} is not a journal that can be read: {error}") from None


def open_intents(rows: tuple[Row, ...]) -> tuple[Row, ...]:
    """Intents without an outcome: after a crash nothing is known of these commands."""
    settled = {row.value["key"] for row in rows if row.kind in ("result", "error", "cancelled")}
    return tuple(row for row in rows if row.kind == "intent" and row.value["key"] not in settled)


def _settle(job: asyncio.Future[list[tuple[_Pending, Row | BaseException]]]) -> None:
    for item, outcome in job.result():
        if isinstance(outcome, BaseException):
            item.done.set_exception(outcome)
            item.done.exception()  # its waiter may be gone: that is no unseen error
        else:
            item.done.set_result(outcome)


def _open(path: Path | None, durable: bool) -> tuple[sqlite3.Connection, Row | None]:
    try:
        database = sqlite3.connect(path or ":memory:", isolation_level=None, check_same_thread=False)
    except sqlite3.Error as error:
        raise JournalUnavailable(f"{path} cannot be opened: {error}") from None
    try:
        return database, _prepare(database, path, durable)
    except BaseException as error:
        database.close()
        if isinstance(error, sqlite3.OperationalError):
            raise JournalUnavailable(f"{path} cannot be opened: {error}") from None
        if isinstance(error, sqlite3.DatabaseError):
            raise RecordCorrupt(f"{path} is not a journal: {error}") from None
        raise


def _close(database: sqlite3.Connection) -> None:
    """A journal at rest is one file: readers of an ended run need no write-ahead log beside it."""
    with contextlib.suppress(sqlite3.Error):  # someone is reading: the log stays, and nothing is lost
        database.execute("PRAGMA journal_mode=DELETE")
    database.close()


def _prepare(database: sqlite3.Connection, path: Path | None, durable: bool) -> Row | None:
    if path is not None:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute(f"PRAGMA synchronous={'FULL' if durable else 'OFF'}")
        database.execute("PRAGMA busy_timeout=5000")
    (version,) = database.execute("PRAGMA user_version").fetchone()
    if version == 0:
        database.executescript(f"BEGIN IMMEDIATE; {TABLE} PRAGMA user_version={SCHEMA}; COMMIT;")
    elif version != SCHEMA:
        raise RecordCorrupt(f"the journal has schema {version}, this program knows {SCHEMA}")
    rows = _rows(database, f"SELECT {COLUMNS} FROM journal ORDER BY seq", ())
    head_of(rows)
    return rows[-1] if rows else None


def _rows(database: sqlite3.Connection, query: str, values: tuple[int, ...]) -> tuple[Row, ...]:
    return tuple(Row(*fields) for fields in database.execute(query, values))


def _copy(database: sqlite3.Connection, path: Path) -> None:
    try:
        database.execute("VACUUM INTO ?", (str(path),))
        with path.open("rb") as file:
            os.fsync(file.fileno())
    except (sqlite3.Error, OSError) as error:
        raise JournalUnavailable(f"{path.name} cannot be written: {error}") from None
