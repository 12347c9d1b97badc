"""What must hold in every journal beyond its chain: commands and their outcomes, blobs and their names. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from cellctl.records.chain import Row

OUTCOMES = ("result", "error", "cancelled")
HASH = re.compile(r"[0-9a-f]{64}")


def exchange_faults(rows: tuple[Row, ...]) -> tuple[str, ...]:
    """Commands that were not written down as they must: outcome without intent, key used twice, two outcomes."""
    faults: list[str] = []
    intents: set[str] = set()
    settled: set[str] = set()
    for row in rows:
        if row.kind != "intent" and row.kind not in OUTCOMES:
            continue
        key = str(row.value.get("key"))
        if row.kind == "intent":
            if key in intents:
                faults.append(f"row {row.seq}: key {key} was used before")
            intents.add(key)
            continue
        if key not in intents:
            faults.append(f"row {row.seq}: {row.kind} of {key} without an intent before it")
        if key in settled:
            faults.append(f"row {row.seq}: a second outcome of {key}")
        settled.add(key)
    return tuple(faults)


def blob_hashes(rows: tuple[Row, ...]) -> frozenset[str]:
    """Content hashes of every blob that the journal names."""
    return frozenset(digest for row in rows if '"blob"' in row.payload for digest in _walk(row.value))


def _walk(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        digest = value.get("blob")
        if isinstance(digest, str) and HASH.fullmatch(digest):
            yield digest
        for item in value.values():
            yield from _walk(item)
    elif isinstance(value, list):
        for item in value:
            yield from _walk(item)
