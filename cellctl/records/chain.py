"""The hash chain: every byte of a row is in it. Pure functions.

hash_n = SHA-256(canonical JSON of [schema, seq, time_s, utc, kind, payload text, hash_(n-1)]); the chain begins with
the hash of the schema's name. Sequence numbers start at 1 and have no gap.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from cellctl.records.canonical import canonical
from cellctl.records.errors import RecordCorrupt

SCHEMA = 1
GENESIS = hashlib.sha256(f"cellctl journal schema {SCHEMA}".encode()).hexdigest()
ROW_KEYS = ("hash", "kind", "payload", "prev", "seq", "time_s", "utc")


@dataclass(frozen=True, slots=True)
class Row:
    """One row. `time_s` is cell time (monotonic), `utc` RFC 3339, `payload` canonical JSON text."""

    seq: int
    time_s: float
    utc: str
    kind: str
    payload: str
    prev: str
    hash: str

    @property
    def value(self) -> Any:
        """The payload, parsed."""
        return json.loads(self.payload)

    def line(self) -> str:
        """The row as one line of an exported journal: canonical JSON with the payload as an object."""
        before, after = (canonical({key: getattr(self, key) for key in keys}) for keys in (ROW_KEYS[:2], ROW_KEYS[3:]))
        return f'{before[:-1]},"payload":{self.payload},{after[1:]}'


def link(seq: int, time_s: float, utc: str, kind: str, payload: str, prev: str) -> Row:
    """The row that follows the one with hash `prev`."""
    text = canonical([SCHEMA, seq, time_s, utc, kind, payload, prev])
    return Row(seq, time_s, utc, kind, payload, prev, hashlib.sha256(text.encode()).hexdigest())


def head_of(rows: Iterable[Row]) -> str:
    """Hash of the last row. Raises RecordCorrupt at the first row that does not follow from the one before."""
    head = GENESIS
    for seq, row in enumerate(rows, 1):
        if row.seq != seq:
            raise RecordCorrupt(f"row {row.seq} stands where row {seq} belongs")
        if row.prev != head:
            raise RecordCorrupt(f"row {seq} does not follow from the row before it")
        if link(row.seq, row.time_s, row.utc, row.kind, row.payload, row.prev).hash != row.hash:
            raise RecordCorrupt(f"row {seq} is not what was written")
        head = row.hash
    return head


def row_of_line(line: str) -> Row:
    """A row from a line of an exported journal. Raises RecordCorrupt unless it is canonical to the last byte."""
    try:
        fields = json.loads(line)
        payload = canonical(fields.pop("payload"))
        row = Row(payload=payload, **fields)
        same = row.line() == line
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise RecordCorrupt(f"not a row of a journal: {type(error).__name__}") from None
    texts = (row.utc, row.kind, row.prev, row.hash)
    if not same or not all(isinstance(text, str) for text in texts) or type(row.seq) is not int:
        raise RecordCorrupt("a row is not in canonical form")
    if not isinstance(row.time_s, float):
        raise RecordCorrupt("a row is not in canonical form")
    return row
