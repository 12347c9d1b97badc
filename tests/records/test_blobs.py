import asyncio
import io
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cellctl.records.blobs import BlobStore, HashOnly, content_hash, dropped_by, load, packed, store, unpacked
from cellctl.records.errors import JournalUnavailable, RecordCorrupt
from hal.clock import run_virtual
from tests.records.world import desk


def cloud(seed: int = 1) -> dict[str, np.ndarray]:
    points = np.random.default_rng(seed).normal(size=(20, 30, 3)).astype(np.float32)
    points[0, 0] = np.nan
    return {"points_mm": points}


def test_the_hash_is_of_names_and_content_alone() -> None:
    assert content_hash(cloud()) == content_hash({"points_mm": np.asfortranarray(cloud()["points_mm"])})
    assert content_hash(cloud()) == content_hash({"points_mm": cloud()["points_mm"].astype(">f4")})
    different = [cloud(2), {"other": cloud()["points_mm"]}, {"points_mm": cloud()["points_mm"].reshape(30, 20, 3)}]
    assert len({content_hash(arrays) for arrays in [cloud(), *different]}) == 4
    assert packed(cloud()) == packed(cloud())


def test_what_is_stored_comes_back_and_numpy_opens_it(tmp_path: Path) -> None:
    arrays = {"z_mm": np.arange(5.0), "force_n": np.zeros(5), "scalar": np.float64(3.0)}
    digest = store(tmp_path / "blobs", arrays)
    assert [path.name for path in (tmp_path / "blobs").iterdir()] == [f"{digest}.npz"]
    back = load(tmp_path / "blobs", digest)
    assert sorted(back) == ["force_n", "scalar", "z_mm"]
    np.testing.assert_array_equal(back["z_mm"], arrays["z_mm"])
    with np.load(tmp_path / "blobs" / f"{digest}.npz") as opened:
        np.testing.assert_array_equal(opened["z_mm"], arrays["z_mm"])
    assert store(tmp_path / "blobs", arrays) == digest


def test_a_changed_or_missing_blob_is_noticed(tmp_path: Path) -> None:
    digest = store(tmp_path, {"a": np.arange(5.0)})
    (tmp_path / f"{digest}.npz").write_bytes(packed({"a": np.arange(6.0)}))
    with pytest.raises(RecordCorrupt, match="not what was written"):
        load(tmp_path, digest)
    with pytest.raises(RecordCorrupt, match="missing"):
        load(tmp_path, "0" * 64)


def test_objects_are_refused() -> None:
    with pytest.raises(TypeError):
        content_hash({"a": np.array([object()])})


def lying_header(shape: str) -> bytes:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (64 - (10 + len(header) + 1) % 64) + b"\n"
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + b"\0" * 16
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.npy", data)
    return buffer.getvalue()


def test_the_header_that_lies_is_the_one_refused() -> None:
    assert unpacked(lying_header("(2,)"))["a"].tolist() == [0.0, 0.0]
    for shape in ("(3,)", "(100000000000000,)", "(-2,)", "(1,)"):
        with pytest.raises(RecordCorrupt):
            unpacked(lying_header(shape))


@pytest.mark.parametrize("damage", [b"", b"PK", b"not a zip at all" * 20])
def test_rubbish_is_refused(damage: bytes) -> None:
    with pytest.raises(RecordCorrupt):
        unpacked(damage)


def test_any_flipped_byte_is_noticed_or_harmless() -> None:
    whole = packed({"a": np.arange(4.0)})
    digest = content_hash({"a": np.arange(4.0)})
    noticed = 0
    for place in range(len(whole)):
        changed = bytearray(whole)
        changed[place] ^= 0x10
        try:
            noticed += content_hash(unpacked(bytes(changed))) != digest
        except RecordCorrupt:
            noticed += 1
    assert noticed > len(whole) / 2


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, a=np.array([{"x": 1}], dtype=object))
    with pytest.raises(RecordCorrupt):
        unpacked(buffer.getvalue())


def test_policy_none_keeps_traces_but_no_scans(tmp_path: Path) -> None:
    async def main() -> tuple[str, str, str]:
        blobs = BlobStore(tmp_path, keep="none")
        scan = await blobs.put(cloud(), scan=True)
        trace = await blobs.put({"a": np.arange(3.0)}, scan=False)
        await blobs.close()
        return scan, trace, await HashOnly().put(cloud(), scan=True)

    before = threading.active_count()
    scan, trace, same = asyncio.run(main())
    assert threading.active_count() == before
    assert scan == same == content_hash(cloud())
    assert [path.stem for path in tmp_path.iterdir()] == [trace]


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "blobs").write_text("a file stands in the way")
    with pytest.raises(JournalUnavailable):
        store(tmp_path / "blobs", {"a": np.arange(3.0)})


def test_decision_scans_are_the_ones_that_a_measurement_was_taken_from() -> None:
    async def main() -> tuple[list[str], list[set[int]]]:
        at = await desk()
        hashes = []
        for seed, kind in enumerate(
            ["scan_artefact_rotor", "scan_rotor", "scan_rotor", "scan_shaft", "scan_shaft", "force_curve"]
        ):
            hashes.append(await at.ledger.blob(kind, cloud(seed)))
            if seed == 0:
                await at.ledger.note("artefact", {"side": "rotor"})
            if seed in (2, 3):
                await at.ledger.note("measurement", {"side": "rotor" if seed == 2 else "shaft"})
        rows = await at.journal.rows()
        await at.close()
        return hashes, [{hashes.index(name) for name in dropped_by(keep, rows)} for keep in ("all", "decision", "none")]

    _, (everything, decision, none) = run_virtual(main())
    assert everything == set()
    assert decision == {1, 4}
    assert none == {0, 1, 2, 3, 4}
