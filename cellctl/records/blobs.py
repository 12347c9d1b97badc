"""Arrays (scans, traces, force curves) stored by the hash of their content.

The hash is SHA-256 over names and npy bytes, so it does not depend on compression, machine or whether the blob is
kept. A stored blob is an npz file (numpy.load opens it), synced before its hash goes into the journal.
"""

from __future__ import annotations

import asyncio
import hashlib
import io
import math
import zipfile
import zlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from cellctl.records.chain import Row
from cellctl.records.errors import JournalUnavailable, RecordCorrupt
from cellctl.whole_file import whole_file
from hal.clock import standing_still

Keep = Literal["all", "decision", "none"]
"""Which scans are kept: every one, those that a measurement was taken from, or none. Traces and curves always are."""

Arrays = Mapping[str, NDArray[Any]]
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
MAX_BLOB_BYTES = 1 << 30
"""Unpacked size beyond which a blob is taken for a bomb: fifteen times the largest scan."""


class Blobs(Protocol):
    """Where arrays go. `put` returns the content hash once the blob is durable."""

    async def put(self, arrays: Arrays, *, scan: bool) -> str: ...
    async def close(self) -> None: ...


class BlobStore:
    """A folder of npz files named by content hash, written by one thread of its own."""

    def __init__(self, folder: Path, *, keep: Keep = "all", durable: bool = True) -> None:
        self._folder = folder
        self._keep = keep
        self._durable = durable
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="blobs")

    async def put(self, arrays: Arrays, *, scan: bool) -> str:
        """Raises JournalUnavailable where it cannot be written."""
        loop = asyncio.get_running_loop()
        with standing_still():  # a quickened clock must not count what hash and disk take
            if scan and self._keep == "none":
                return await loop.run_in_executor(self._executor, content_hash, arrays)
            return await loop.run_in_executor(self._executor, store, self._folder, arrays, self._durable)

    async def close(self) -> None:
        self._executor.shutdown(wait=True)


class HashOnly:
    """For studies: content hashes as in any other store, nothing kept."""

    async def put(self, arrays: Arrays, *, scan: bool) -> str:
        return content_hash(arrays)

    async def close(self) -> None:
        """Nothing to close."""


def content_hash(arrays: Arrays) -> str:
    """SHA-256 (hex) over names and npy bytes, names in order."""
    digest = hashlib.sha256()
    for name, data in _members(arrays):
        digest.update(f"{name}\0{len(data)}\0".encode())
        digest.update(data)
    return digest.hexdigest()


def store(folder: Path, arrays: Arrays, durable: bool = True) -> str:
    """Write the blob unless it is there, sync file and folder where `durable`, return its content hash. Blocking."""
    digest = content_hash(arrays)
    path = folder / f"{digest}.npz"
    if path.exists():
        return digest
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path, durable=durable) as file:
            file.write(packed(arrays))
    except OSError as error:
        raise JournalUnavailable(f"a blob cannot be written: {error}") from None
    return digest


def packed(arrays: Arrays) -> bytes:
    """npz bytes that depend on the arrays alone."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in _members(arrays):
            info = zipfile.ZipInfo(f"{name}.npy", ZIP_EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3
            archive.writestr(info, data)
    return buffer.getvalue()


def unpacked(data: bytes) -> dict[str, NDArray[Any]]:
    """Arrays of npz bytes. Raises RecordCorrupt for anything else, pickles and bombs included."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(info.file_size for info in archive.infolist()) > MAX_BLOB_BYTES:
                raise RecordCorrupt("a blob is larger than any scan")
            return {info.filename.removesuffix(".npy"): _array(archive.read(info)) for info in archive.infolist()}
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError, RuntimeError) as error:
        raise RecordCorrupt(f"a blob cannot be read: {error}") from None


def load(folder: Path, digest: str) -> dict[str, NDArray[Any]]:
    """Arrays of the blob with content hash `digest`. Raises RecordCorrupt where it is missing or changed. Blocking."""
    try:
        arrays = unpacked((folder / f"{digest}.npz").read_bytes())
    except OSError as error:
        raise RecordCorrupt(f"blob {digest[:12]} is missing: {error}") from None
    if content_hash(arrays) != digest:
        raise RecordCorrupt(f"blob {digest[:12]} is not what was written")
    return arrays


def is_kept(folder: Path, digest: str) -> bool:
    """Whether the blob with that content hash is there. Blocking."""
    return (folder / f"{digest}.npz").exists()


def dropped_by(keep: Keep, rows: tuple[Row, ...]) -> frozenset[str]:
    """Hashes of the scans that the policy does not keep, from a run's journal.

    A decision scan is the last one of its view before a measurement or an artefact check was taken from it.
    """
    scans: set[str] = set()
    latest: dict[str, str] = {}
    decided: set[str] = set()
    for row in rows:
        for kind, digest in scans_of(row):
            scans.add(digest)
            latest[kind] = digest
        if row.kind in DECISIONS:
            decided.add(latest.get(DECISIONS[row.kind].format(row.value.get("side")), ""))
    if keep == "all":
        return frozenset()
    return frozenset(scans - decided if keep == "decision" else scans)


def scans_of(row: Row) -> tuple[tuple[str, str], ...]:
    """Kind ("scan_VIEW") and hash of each cloud that a row names: a scanner's result, or a blob noted as a scan."""
    if row.kind == "blob":
        value = row.value
        return ((value["kind"], value["blob"]),) if is_scan(value["kind"]) else ()
    if row.kind != "result" or '"blob"' not in row.payload:
        return ()
    value = row.value
    result = value.get("result")
    if not is_scan(str(value.get("device"))) or not isinstance(result, dict):
        return ()
    named = [item["blob"] for item in result.values() if isinstance(item, dict) and "blob" in item]
    return tuple((f"scan_{result.get('view')}", str(digest)) for digest in named)


DECISIONS = MappingProxyType({"measurement": "scan_{}", "artefact": "scan_artefact_{}"})
"""Kind of row that a decision stands on, and the kind of the scan that it was taken from."""


def is_scan(kind: str) -> bool:
    """Whether a blob of that kind, or from that device, is a camera's cloud."""
    return kind.startswith("scan")


def _members(arrays: Arrays) -> list[tuple[str, bytes]]:
    return [(name, _npy(np.asarray(arrays[name]))) for name in sorted(arrays)]


def _npy(array: NDArray[Any]) -> bytes:
    if array.dtype.hasobject:
        raise TypeError("an array of objects has no canonical form")
    buffer = io.BytesIO()
    little = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    np.lib.format.write_array(buffer, np.ascontiguousarray(little), version=(1, 0), allow_pickle=False)
    return buffer.getvalue()


def _array(data: bytes) -> NDArray[Any]:
    """An npy array whose header claims no more than what follows it."""
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("not the npy version of this store")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    if fortran or dtype.hasobject or math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise ValueError("an npy header does not fit its data")
    return np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape)
