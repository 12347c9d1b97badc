"""Offline check of a sealed record: signature, manifest, every file, chain, commands, blobs. Trusts nothing in it."""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from cellctl.records.audit import blob_hashes, exchange_faults
from cellctl.records.blobs import content_hash, dropped_by, unpacked
from cellctl.records.canonical import canonical
from cellctl.records.chain import Row, head_of, row_of_line
from cellctl.records.errors import RecordCorrupt
from cellctl.records.seal import CONTEXT, FORMAT, read_public

NAME = re.compile(r"manifest\.json|manifest\.sig|cell\.pub|journal\.jsonl|report\.html|blobs/[0-9a-f]{64}\.npz")
MAX_FILES = 20_000
MAX_FILE_BYTES = 1 << 30
MAX_TOTAL_BYTES = 8 << 30
MAX_RATIO = 1200
"""Deflate packs no better than 1032 to 1; a member that claims more is a bomb or a lie."""

UNREADABLE = (
    zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError, KeyError, TypeError, AttributeError
)  # fmt: skip
"""What zipfile and values of unexpected types raise (OSError: a seek to before the file): nothing the cell sealed."""

NEEDED = ("manifest.json", "manifest.sig", "cell.pub", "journal.jsonl", "report.html")
MANIFEST_KEYS = {"format", "run_id", "sealed_at", "rows", "head", "keep", "scans_not_kept", "files"}


@dataclass(frozen=True, slots=True)
class Verification:
    """`authentic`: whole, and signed by the key that was given. `consistent`: whole, not authenticated."""

    status: Literal["authentic", "consistent", "rejected"]
    reasons: tuple[str, ...]
    run_id: str = ""
    rows: int = 0
    head: str = ""

    @property
    def ok(self) -> bool:
        """Whether nothing speaks against the record."""
        return self.status != "rejected"


def verify(path: Path, key: Ed25519PublicKey | None = None) -> Verification:
    """Check the record at `path`; with `key`, that the cell with that key sealed it. Never raises for its contents.

    Raises OSError where the file itself cannot be opened. Blocking.
    """
    with path.open("rb") as file:
        return _verified_file(file, key)


def _verified_file(file: BinaryIO, key: Ed25519PublicKey | None) -> Verification:
    try:
        with zipfile.ZipFile(file) as archive:
            return _verified(archive, key)
    except RecordCorrupt as corrupt:
        return Verification("rejected", (corrupt.reason,))
    except UNREADABLE as error:
        return Verification("rejected", (f"not a whole record: {type(error).__name__}: {error}",))


def _verified(archive: zipfile.ZipFile, key: Ed25519PublicKey | None) -> Verification:
    members = _members(archive)

    def read(name: str) -> bytes:
        return _read(archive, members[name])

    manifest = _manifest(read("manifest.json"))
    _check_signature(read("manifest.json"), read("manifest.sig"), key or read_public(read("cell.pub")))
    listed: dict[str, str] = manifest["files"]
    extra = set(members) - set(listed) - {"manifest.json", "manifest.sig", "cell.pub"}
    missing = set(listed) - set(members)
    if extra or missing:
        raise RecordCorrupt(f"files beside the manifest: {sorted(extra)}; files missing: {sorted(missing)}")
    for name, digest in listed.items():
        if hashlib.sha256(read(name)).hexdigest() != digest:
            raise RecordCorrupt(f"{name} is not what was sealed")
    rows = _rows(read("journal.jsonl"))
    head = head_of(rows)
    if (head, len(rows)) != (manifest["head"], manifest["rows"]):
        raise RecordCorrupt(f"the journal ends at row {len(rows)}, the manifest speaks of row {manifest['rows']}")
    reasons = exchange_faults(rows)
    if reasons:
        return Verification("rejected", reasons)
    _check_blobs(rows, manifest, listed, read)
    status: Literal["authentic", "consistent"] = "authentic" if key else "consistent"
    note = () if key else ("consistent, not authenticated: no key was given",)
    return Verification(status, note, str(manifest["run_id"]), len(rows), head)


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Members by name, none of them a surprise: known plain names, each once, of bounded size."""
    infos = archive.infolist()
    if len(infos) > MAX_FILES:
        raise RecordCorrupt(f"{len(infos)} files are more than any record has")
    members: dict[str, zipfile.ZipInfo] = {}
    for info in infos:
        if not NAME.fullmatch(info.filename) or info.filename in members:
            raise RecordCorrupt(f"unexpected file {info.filename[:80]!r}")
        if info.file_size > MAX_FILE_BYTES or info.file_size > MAX_RATIO * max(info.compress_size, 1):
            raise RecordCorrupt(f"{info.filename} is too large to be true")
        if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise RecordCorrupt(f"{info.filename} is packed in another way than records are")
        members[info.filename] = info
    if sum(info.file_size for info in infos) > MAX_TOTAL_BYTES:
        raise RecordCorrupt("the record is too large to be true")
    for name in NEEDED:
        if name not in members:
            raise RecordCorrupt(f"{name} is missing")
    return members


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """One member, never more bytes than it declares."""
    with archive.open(info) as file:
        data = file.read(info.file_size + 1)
    if len(data) != info.file_size:
        raise RecordCorrupt(f"{info.filename} has another size than it says")
    return data


def _manifest(data: bytes) -> dict[str, Any]:
    try:
        manifest = json.loads(data)
        whole = isinstance(manifest, dict) and set(manifest) == MANIFEST_KEYS and canonical(manifest).encode() == data
    except (ValueError, TypeError, RecursionError):
        whole = False
    if not whole or manifest["format"] != FORMAT:
        raise RecordCorrupt("manifest.json is not a manifest of a known format")
    names = manifest["files"]
    listed = isinstance(names, dict) and all(NAME.fullmatch(name) and isinstance(names[name], str) for name in names)
    if (
        not listed
        or not {"journal.jsonl", "report.html"} <= set(names)
        or manifest["keep"] not in ("all", "decision", "none")
    ):
        raise RecordCorrupt("manifest.json does not list the files of a record")
    fields: dict[str, Any] = manifest
    return fields


def _check_signature(manifest: bytes, signature: bytes, key: Ed25519PublicKey) -> None:
    try:
        key.verify(signature, CONTEXT + manifest)
    except InvalidSignature:
        raise RecordCorrupt("the signature is not of this key over this manifest") from None


def _rows(data: bytes) -> tuple[Row, ...]:
    try:
        lines = data.decode().split("\n")
    except UnicodeDecodeError:
        raise RecordCorrupt("journal.jsonl is not text") from None
    if lines.pop() != "":
        raise RecordCorrupt("journal.jsonl ends within a row")
    return tuple(row_of_line(line) for line in lines)


def _check_blobs(
    rows: tuple[Row, ...], manifest: dict[str, Any], listed: dict[str, str], read: Callable[[str], bytes]
) -> None:
    dropped = dropped_by(manifest["keep"], rows)
    if sorted(dropped) != manifest["scans_not_kept"]:
        raise RecordCorrupt("other scans are missing than the manifest's policy drops")
    wanted = {f"blobs/{digest}.npz" for digest in blob_hashes(rows) - dropped}
    stored = {name for name in listed if name.startswith("blobs/")}
    if wanted != stored:
        raise RecordCorrupt(
            f"{len(wanted - stored)} blobs of the journal are missing, {len(stored - wanted)} are unknown"
        )
    for name in sorted(stored):
        if f"blobs/{content_hash(unpacked(read(name)))}.npz" != name:
            raise RecordCorrupt(f"{name} does not hold what its name says")


def read_record(path: Path) -> tuple[tuple[Row, ...], Callable[[str], dict[str, Any]]]:
    """Rows of a sealed record that is whole, and a reader of its blobs by hash. Raises RecordCorrupt, OSError."""
    result = verify(path)
    if not result.ok:
        raise RecordCorrupt(result.reasons[0])
    with zipfile.ZipFile(path) as archive:
        rows = _rows(archive.read("journal.jsonl"))

    def blob(digest: str) -> dict[str, Any]:
        with zipfile.ZipFile(path) as archive:
            name = f"blobs/{digest}.npz"
            if name not in archive.namelist():
                raise RecordCorrupt(f"{name} is not kept in the record")
            return dict(unpacked(archive.read(name)))

    return rows, blob
