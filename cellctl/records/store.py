"""All runs under one data folder: begin one, end one, list and read them.

::

    DATA/keys/cell_ed25519.pem, .pub
    DATA/runs/RUN/journal.sqlite, blobs/HASH.npz, report.html, record.zip, summary.json

Everything but journal and blobs can be made again from them.
"""

from __future__ import annotations

import asyncio
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from cellctl.records.blobs import BlobStore, Keep, dropped_by, is_kept, load
from cellctl.records.canonical import canonical
from cellctl.records.chain import Row, head_of
from cellctl.records.errors import JournalUnavailable, RecordCorrupt, UnknownRun
from cellctl.records.journal import Journal, open_intents, read_rows
from cellctl.records.ledger import JournalLedger
from cellctl.records.report import report_of
from cellctl.records.scans import RunScan, run_scans
from cellctl.records.seal import Sealing, cell_key, seal
from cellctl.records.summary import RunEnded, RunHeader, RunSummary, as_plain, from_plain, summarise
from cellctl.stamps import Stamps

T = TypeVar("T")
WATERMARK_BYTES = 256 << 20
"""Free space without which no run begins: it holds the scans, journal and record of one run with room to spare."""
RUN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_\-]{0,79}")


@dataclass(frozen=True, slots=True)
class OpenRun:
    """A run that is being written. `end` is called once, whatever came of it."""

    run_id: str
    folder: Path
    journal: Journal
    ledger: JournalLedger
    blobs: BlobStore
    stamps: Stamps
    keep: Keep

    async def end(self, ended: RunEnded) -> Path:
        """Write how it ended, close the journal, drop what the policy drops, seal; gives the record's path.

        Journal and threads are closed even where sealing fails; the error is then raised.
        """
        try:
            await self.ledger.note("ended", ended)
        finally:
            await self.journal.close()
            await self.blobs.close()
        job = partial(finish, self.folder, self.keep, self.run_id, self.stamps.now())
        return await asyncio.get_running_loop().run_in_executor(None, job)


class RunStore:
    """The runs below one data folder."""

    def __init__(self, data: Path, *, watermark_bytes: int = WATERMARK_BYTES, durable: bool = True) -> None:
        self._runs = data / "runs"
        self._durable = durable
        self._watermark_bytes = watermark_bytes

    async def begin(self, header: RunHeader, stamps: Stamps, *, keep: Keep = "all", replace: bool = False) -> OpenRun:
        """A new run with its header written.

        `replace` makes room where a run of that id is stored already: for runs in virtual time, whose ids follow from
        the seed. Raises JournalUnavailable, UnknownRun for an id that names no folder.
        """
        folder = self._folder(header.run_id)
        try:
            if replace and folder.exists():
                shutil.rmtree(folder)
            folder.mkdir(parents=True)
            free = shutil.disk_usage(folder).free
        except OSError as error:
            raise JournalUnavailable(f"run {header.run_id} cannot be begun: {error}") from None
        if free < self._watermark_bytes:
            folder.rmdir()
            needed = f"{self._watermark_bytes >> 20} MB are needed"
            raise JournalUnavailable(f"{free >> 20} MB are free for records, {needed} to begin a run")
        return await self._open(header.run_id, stamps, keep, header)

    async def resume(self, run_id: str, stamps: Stamps, *, keep: Keep = "all") -> tuple[OpenRun, tuple[Row, ...]]:
        """A run that a crash left open, its chain checked, and the intents of which nothing more is known."""
        self._existing(run_id)
        run = await self._open(run_id, stamps, keep, None)
        return run, open_intents(await run.journal.rows())

    async def ids(self) -> tuple[str, ...]:
        """All runs, the latest first."""
        return await self._job(self._ids)

    async def list(self, *, limit: int = 50, after: str | None = None) -> tuple[RunSummary, ...]:
        """Runs, the latest first, from behind the run `after` on. Raises UnknownRun where `after` is none."""
        ids = await self.ids()
        if after is not None and after not in ids:
            raise UnknownRun(f"no run {after!r}")
        start = ids.index(after) + 1 if after is not None else 0
        folders = [self._runs / run_id for run_id in ids[start : start + limit]]
        return await self._job(lambda: tuple(summary_in(folder) for folder in folders))

    async def get(self, run_id: str) -> RunSummary:
        """Summary of one run, running or ended. Raises UnknownRun, RecordCorrupt."""
        folder = self._existing(run_id)
        return await self._job(lambda: summarise(read_rows(folder / "journal.sqlite")))

    async def rows(self, run_id: str, *, after: int = 0, limit: int = 1000) -> tuple[Row, ...]:
        """Journal rows with a number above `after`."""
        folder = self._existing(run_id)
        return await self._job(lambda: read_rows(folder / "journal.sqlite", after=after, limit=limit))

    async def blob(self, run_id: str, digest: str) -> dict[str, Any]:
        """Arrays of one blob of a run. Raises RecordCorrupt where it is missing or changed."""
        folder = self._existing(run_id)
        if not re.fullmatch(r"[0-9a-f]{64}", digest):
            raise RecordCorrupt("not a content hash")
        return await self._job(lambda: load(folder / "blobs", digest))

    async def scans(self, run_id: str) -> tuple[tuple[RunScan, bool], ...]:
        """Every scan of a run in the order in which they were taken, and whether its cloud is kept."""
        folder = self._existing(run_id)

        def found() -> tuple[tuple[RunScan, bool], ...]:
            scans = run_scans(read_rows(folder / "journal.sqlite"))
            return tuple((scan, is_kept(folder / "blobs", scan.blob)) for scan in scans)

        return await self._job(found)

    def folder_of(self, run_id: str) -> Path:
        """Where a run lies, for work in another process. Raises UnknownRun."""
        return self._existing(run_id)

    async def report(self, run_id: str) -> str:
        """HTML report, from what is in the journal now."""
        folder = self._existing(run_id)
        return await self._job(lambda: report_from(folder))

    def record_path(self, run_id: str) -> Path | None:
        """The sealed record; None until the run is sealed. Raises UnknownRun."""
        path = self._existing(run_id) / "record.zip"
        return path if path.exists() else None

    async def _open(self, run_id: str, stamps: Stamps, keep: Keep, header: RunHeader | None) -> OpenRun:
        folder = self._folder(run_id)
        journal = await Journal.open(folder / "journal.sqlite", stamps, durable=self._durable)
        blobs = BlobStore(folder / "blobs", keep=keep, durable=self._durable)
        run = OpenRun(run_id, folder, journal, JournalLedger(journal, blobs, stamps), blobs, stamps, keep)
        try:
            if header is not None:
                await run.ledger.note("run", header)
        except BaseException:
            await journal.close()
            await blobs.close()
            raise
        return run

    def _ids(self) -> tuple[str, ...]:
        found = [(_began(path), path.parent.name) for path in self._runs.glob("*/journal.sqlite")]
        return tuple(name for _, name in sorted(found, reverse=True))

    def _folder(self, run_id: str) -> Path:
        if not RUN_ID.fullmatch(run_id):
            raise UnknownRun(f"{run_id[:80]!r} is no run id")
        return self._runs / run_id

    def _existing(self, run_id: str) -> Path:
        folder = self._folder(run_id)
        if not (folder / "journal.sqlite").exists():
            raise UnknownRun(f"no run {run_id!r}")
        return folder

    async def _job(self, job: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(None, job)


def finish(folder: Path, keep: Keep, run_id: str, sealed_at: datetime) -> Path:
    """Drop the scans that the policy drops, write report, summary and sealed record. Blocking."""
    rows = read_rows(folder / "journal.sqlite")
    head_of(rows)
    for digest in dropped_by(keep, rows):
        (folder / "blobs" / f"{digest}.npz").unlink(missing_ok=True)
    report = report_from(folder)
    (folder / "report.html").write_text(report, encoding="utf-8")
    (folder / "summary.json").write_text(canonical(as_plain(summarise(rows))) + "\n", encoding="utf-8")
    record = folder / "record.zip"
    sealing = Sealing(run_id, folder / "blobs", keep, report, sealed_at)
    seal(record, rows, sealing, cell_key(folder.parent.parent / "keys"))
    return record


def report_from(folder: Path) -> str:
    """HTML report of the run in `folder`. Blocking."""
    return report_of(read_rows(folder / "journal.sqlite"), partial(load, folder / "blobs"))


def _began(journal: Path) -> str:
    """UTC of the first row; empty where there is none."""
    rows = read_rows(journal, limit=1)
    return rows[0].utc if rows else ""


def summary_in(folder: Path) -> RunSummary:
    """The summary that was written when the run in `folder` ended; of a running one, from its journal. Blocking."""
    try:
        return from_plain(json.loads((folder / "summary.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return summarise(read_rows(folder / "journal.sqlite"))
