"""The sealed record: one ZIP with manifest, journal, blobs, report and the cell's signature.

::

    manifest.json   canonical JSON: run, rows, head hash, SHA-256 of every other file, hashes of scans not kept
    manifest.sig    Ed25519 over "cellctl record 1" NUL manifest.json, 64 bytes
    cell.pub        the cell's public key (PEM); proves nothing by itself
    journal.jsonl   one canonical row a line
    report.html
    blobs/HASH.npz

The same run sealed with the same key at the same time gives the same bytes.
"""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from cellctl.records.audit import blob_hashes
from cellctl.records.blobs import ZIP_EPOCH, Keep, dropped_by
from cellctl.records.canonical import canonical
from cellctl.records.chain import Row, head_of
from cellctl.records.errors import JournalUnavailable, RecordCorrupt
from cellctl.whole_file import whole_file

FORMAT = 1
CONTEXT = f"cellctl record {FORMAT}\0".encode()
"""In front of the signed bytes, so that the key's signature of anything else never fits a record."""


@dataclass(frozen=True, slots=True)
class Sealing:
    """What goes into a record beside the rows: where the blobs lie, which scans stay, the report, the time."""

    run_id: str
    blobs: Path
    keep: Keep
    report: str
    sealed_at: datetime


def seal(path: Path, rows: tuple[Row, ...], sealing: Sealing, key: Ed25519PrivateKey) -> str:
    """Write the sealed record to `path`, durable when this returns; gives the SHA-256 of the file. Blocking.

    Raises RecordCorrupt where the chain is broken or a blob is missing, JournalUnavailable where it cannot be written.
    """
    head = head_of(rows)
    dropped = dropped_by(sealing.keep, rows)
    kept = sorted(blob_hashes(rows) - dropped)
    files: dict[str, bytes] = {
        "journal.jsonl": "".join(row.line() + "\n" for row in rows).encode(),
        "report.html": sealing.report.encode(),
    }
    try:
        files |= {f"blobs/{digest}.npz": (sealing.blobs / f"{digest}.npz").read_bytes() for digest in kept}
    except OSError as error:
        raise RecordCorrupt(f"a blob that the journal names is missing: {error}") from None
    manifest = manifest_of(rows, head, files, sorted(dropped), sealing)
    public = public_pem(key.public_key())
    signed = {"manifest.json": manifest, "manifest.sig": key.sign(CONTEXT + manifest), "cell.pub": public}
    return _write(path, signed | files)


def manifest_of(
    rows: tuple[Row, ...], head: str, files: dict[str, bytes], dropped: list[str], sealing: Sealing
) -> bytes:
    """Canonical JSON of the manifest."""
    fields: dict[str, Any] = {
        "format": FORMAT,
        "run_id": sealing.run_id,
        "sealed_at": sealing.sealed_at,
        "rows": len(rows),
        "head": head,
        "keep": sealing.keep,
        "scans_not_kept": dropped,
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
    }
    return canonical(fields).encode()


def cell_key(folder: Path) -> Ed25519PrivateKey:
    """The cell's signing key in `folder`, made at first use with mode 0600; its public half lies beside it.

    Raises RecordCorrupt for a file that is no Ed25519 key.
    """
    path = folder / "cell_ed25519.pem"
    if not path.exists():
        _make_key(path)
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise RecordCorrupt(f"{path.name} is no key: {error}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise RecordCorrupt(f"{path.name} is no Ed25519 key")
    (folder / "cell_ed25519.pub").write_bytes(public_pem(key.public_key()))
    return key


def public_pem(key: Ed25519PublicKey) -> bytes:
    """A public key as PEM."""
    return key.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)


def read_public(data: bytes) -> Ed25519PublicKey:
    """A public key from PEM. Raises RecordCorrupt."""
    try:
        key = serialization.load_pem_public_key(data)
    except (ValueError, TypeError) as error:
        raise RecordCorrupt(f"not a public key: {error}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise RecordCorrupt("not an Ed25519 public key")
    return key


def _make_key(path: Path) -> None:
    data = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path, mode=0o600) as file:
        file.write(data)


def _write(path: Path, files: dict[str, bytes]) -> str:
    try:
        with whole_file(path) as file, zipfile.ZipFile(file, "w") as archive:
            for name, data in files.items():
                info = zipfile.ZipInfo(name, ZIP_EPOCH)
                info.create_system = 3
                # Blobs are packed already.
                info.compress_type = zipfile.ZIP_STORED if name.endswith(".npz") else zipfile.ZIP_DEFLATED
                archive.writestr(info, data)
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise JournalUnavailable(f"the record cannot be written: {error}") from None
