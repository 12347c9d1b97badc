"""What a forger may try with a sealed record, and what becomes of it."""

from __future__ import annotations

import hashlib
import json
import random
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellctl.records.canonical import canonical
from cellctl.records.chain import GENESIS, head_of, link, row_of_line
from cellctl.records.errors import RecordCorrupt
from cellctl.records.seal import CONTEXT, cell_key, public_pem, read_public
from cellctl.records.verify import verify
from hal.clock import run_virtual
from tests.records.test_store import stored

Files = dict[str, bytes]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    run_virtual(stored(folder))
    return folder


@pytest.fixture
def record(data: Path) -> Path:
    return data / "runs" / "run-1" / "record.zip"


@pytest.fixture
def key(data: Path) -> Ed25519PrivateKey:
    return cell_key(data / "keys")


def files_of(record: Path) -> Files:
    with zipfile.ZipFile(record) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(path: Path, files: Files) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def listed(files: Files, **changes: object) -> Files:
    """With a manifest that fits the files again."""
    manifest = json.loads(files["manifest.json"]) | changes
    outside = ("manifest.json", "manifest.sig", "cell.pub")
    manifest["files"] = {n: hashlib.sha256(c).hexdigest() for n, c in files.items() if n not in outside}
    return files | {"manifest.json": canonical(manifest).encode()}


def signed(files: Files, key: Ed25519PrivateKey) -> Files:
    signature = key.sign(CONTEXT + files["manifest.json"])
    return files | {"manifest.sig": signature, "cell.pub": public_pem(key.public_key())}


def rewritten(files: Files, edit: Callable[[list[tuple[str, str]]], None]) -> Files:
    """With another history whose chain fits again."""
    rows = [row_of_line(line) for line in files["journal.jsonl"].decode().splitlines()]
    story = [(row.kind, row.payload) for row in rows]
    edit(story)
    head, lines = GENESIS, []
    for seq, (kind, payload) in enumerate(story, 1):
        row = link(seq, rows[0].time_s, rows[0].utc, kind, payload, head)
        head = row.hash
        lines.append(row.line() + "\n")
    return listed(files | {"journal.jsonl": "".join(lines).encode()}, head=head, rows=len(lines))


def better_torque(story: list[tuple[str, str]]) -> None:
    place = next(i for i, (kind, _) in enumerate(story) if kind == "joint")
    story[place] = ("joint", story[place][1].replace("36.0", "36.5"))


def without_intent(story: list[tuple[str, str]]) -> None:
    del story[next(i for i, (kind, _) in enumerate(story) if kind == "intent")]


def result_twice(story: list[tuple[str, str]]) -> None:
    story.append(story[next(i for i, (kind, _) in enumerate(story) if kind == "result")])


def intent_twice(story: list[tuple[str, str]]) -> None:
    story.append(story[next(i for i, (kind, _) in enumerate(story) if kind == "intent")])


def test_whole_and_signed(record: Path, key: Ed25519PrivateKey) -> None:
    with_key, without = verify(record, key.public_key()), verify(record)
    assert (with_key.status, with_key.run_id, with_key.reasons) == ("authentic", "run-1", ())
    assert without.status == "consistent"
    assert "not authenticated" in without.reasons[0]
    rows = [row_of_line(line) for line in files_of(record)["journal.jsonl"].decode().splitlines()]
    assert head_of(rows) == with_key.head


def test_the_same_run_with_the_same_key_gives_the_same_bytes(record: Path, data: Path, tmp_path: Path) -> None:
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "cell_ed25519.pem").write_bytes((data / "keys" / "cell_ed25519.pem").read_bytes())
    assert run_virtual(stored(tmp_path)).read_bytes() == record.read_bytes()


def test_a_rewritten_history_with_a_fitting_chain_needs_the_key(
    record: Path, key: Ed25519PrivateKey, tmp_path: Path
) -> None:
    forged = rewritten(files_of(record), better_torque)
    kept_signature = packed(tmp_path / "kept.zip", forged)
    own_key = packed(tmp_path / "own.zip", signed(forged, Ed25519PrivateKey.generate()))
    assert verify(kept_signature).status == "rejected"
    assert verify(kept_signature, key.public_key()).status == "rejected"
    assert verify(own_key, key.public_key()).status == "rejected"
    assert verify(own_key).status == "consistent"  # which is why it says: not authenticated


@pytest.mark.parametrize("edit", [without_intent, result_twice, intent_twice])
def test_even_the_cell_itself_cannot_seal_a_broken_order_of_commands(
    record: Path, key: Ed25519PrivateKey, tmp_path: Path, edit: Callable[[list[tuple[str, str]]], None]
) -> None:
    forged = packed(tmp_path / "forged.zip", signed(rewritten(files_of(record), edit), key))
    assert verify(forged, key.public_key()).status == "rejected"


def tampered(files: Files) -> dict[str, Files]:
    rows = files["journal.jsonl"].splitlines(keepends=True)
    blob = next(name for name in files if name.startswith("blobs/"))
    manifest = json.loads(files["manifest.json"])
    return {
        "a byte of a row": files | {"journal.jsonl": files["journal.jsonl"].replace(b"36.0", b"36.1", 1)},
        "a byte of a row, listed": listed(
            files | {"journal.jsonl": files["journal.jsonl"].replace(b"36.0", b"36.1", 1)}
        ),
        "last row cut off": listed(files | {"journal.jsonl": b"".join(rows[:-1])}),
        "last row cut off and counted": listed(files | {"journal.jsonl": b"".join(rows[:-1])}, rows=len(rows) - 1),
        "half a row": listed(files | {"journal.jsonl": files["journal.jsonl"][:-9]}),
        "rows swapped": listed(files | {"journal.jsonl": b"".join([rows[1], rows[0], *rows[2:]])}),
        "no rows": listed(files | {"journal.jsonl": b""}, rows=0, head=GENESIS),
        "blob changed": listed(files | {blob: files[blob][:-30]}),
        "blob missing": listed({name: content for name, content in files.items() if name != blob}),
        "blob unknown": listed(files | {f"blobs/{'0' * 64}.npz": files[blob]}),
        "report changed": files | {"report.html": b"all is well"},
        "file beside": files | {f"blobs/{'0' * 64}.npz": b""},
        "path out of the record": files | {"../evil": b""},
        "absolute path": files | {"/etc/evil": b""},
        "no signature": {name: content for name, content in files.items() if name != "manifest.sig"},
        "manifest not canonical": files | {"manifest.json": json.dumps(manifest).encode()},
        "manifest of another format": listed(files, format=2),
        "manifest with more": listed(files, more=1),
        "scans said to be dropped": listed(files, keep="none"),
        "manifest a list": files | {"manifest.json": b"[]"},
        "deep nesting": files | {"manifest.json": b"[" * 100_000},
    }


KINDS = sorted(tampered({"journal.jsonl": b"36.0\n1\n", "blobs/x": b"", "manifest.json": b'{"files":{}}'}))


@pytest.mark.parametrize("kind", KINDS)
def test_a_tampered_record_is_rejected_whoever_signs_it(
    record: Path, key: Ed25519PrivateKey, tmp_path: Path, kind: str
) -> None:
    files = tampered(files_of(record))[kind]
    assert verify(packed(tmp_path / "t.zip", files)).status == "rejected"
    if kind not in ("no signature", "report changed", "a byte of a row"):
        assert verify(packed(tmp_path / "s.zip", signed(files, key)), key.public_key()).status == "rejected"


def test_a_bomb_is_not_unpacked(record: Path, tmp_path: Path) -> None:
    path = tmp_path / "bomb.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as archive:
        for name, content in (files_of(record) | {"report.html": b"0" * 50_000_000}).items():
            archive.writestr(name, content)
    result = verify(path)
    assert result.status == "rejected"
    assert "report.html" in result.reasons[0] or "packed" in result.reasons[0]


def test_a_name_twice_is_rejected(record: Path, tmp_path: Path) -> None:
    path = packed(tmp_path / "twice.zip", files_of(record))
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "a") as archive:
        archive.writestr("report.html", b"another")
    assert "report.html" in verify(path).reasons[0]


def test_any_damage_to_the_file_is_rejected_or_harmless_and_never_raises(
    record: Path, key: Ed25519PrivateKey, tmp_path: Path
) -> None:
    whole = record.read_bytes()
    chance = random.Random(3)
    before = verify(record, key.public_key())
    path = tmp_path / "damaged.zip"
    rejected = 0
    for trial in range(150):
        changed = bytearray(whole[: chance.randrange(len(whole))] if trial % 3 == 0 else whole)
        for _ in range(1 + trial % 4):
            changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
        path.write_bytes(changed)
        result = verify(path, key.public_key())
        rejected += result.status == "rejected"
        assert result.status == "rejected" or result == before  # a time stamp of the ZIP says nothing
    assert rejected > 100


def test_a_file_that_is_not_there_is_an_error_of_the_caller(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        verify(tmp_path / "none.zip")


def test_keys_of_another_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordCorrupt):
        read_public(b"not a key")
    (tmp_path / "cell_ed25519.pem").write_bytes(b"not a key")
    with pytest.raises(RecordCorrupt):
        cell_key(tmp_path)
