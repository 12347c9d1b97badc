"""What the tests of the records share: a journal in virtual time and rows of a small run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cellctl.records.blobs import BlobStore, HashOnly
from cellctl.records.journal import Journal
from cellctl.records.ledger import JournalLedger
from cellctl.stamps import VirtualStamps


@dataclass(frozen=True)
class Desk:
    """A journal with its ledger."""

    journal: Journal
    ledger: JournalLedger


async def desk(folder: Path | None = None, *, seed: int = 1, start: int = 0) -> Desk:
    """Journal and blobs in `folder`, or in memory."""
    stamps = VirtualStamps(seed, start=start)
    journal = await Journal.open(folder / "journal.sqlite" if folder else None, stamps)
    blobs = BlobStore(folder / "blobs") if folder else HashOnly()
    return Desk(journal, JournalLedger(journal, blobs, stamps))
