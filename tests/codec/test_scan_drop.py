"""Files of the scanner's folder: fixed bytes, round trips, and what is refused."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hal.codec import cloud_arrays
from hal.codec import scan_drop as drop

CAPTURE = drop.Request(17, "capture", "rotor")
ANSWER = (
    b'{"request": 17, "ok": true, "frame_id": 5, "view": "rotor", "unit": "mm", "age_s": 0.5, '
    b'"file": "00000017.npz", "bytes": 1000, "shape": [2, 3]}'
)
TOLD = drop.FrameTold(5, "rotor", "mm", 0.5, "00000017.npz", 1000, (2, 3))


def test_requests_and_answers_are_these_bytes() -> None:
    assert drop.encode_request(CAPTURE) == b'{"request": 17, "ask": "capture", "view": "rotor"}'
    assert drop.encode_request(drop.Request(3, "halt")) == b'{"request": 3, "ask": "halt"}'
    assert CAPTURE.stem == "00000017"
    assert drop.encode_answer(17, TOLD) == ANSWER
    assert drop.decode_answer(ANSWER, CAPTURE) == TOLD


@pytest.mark.parametrize(
    ("ask", "answer"),
    [
        ("identify", drop.IdentityTold("maker", "SL", "7", "1.2")),
        ("state", drop.StateTold(True)),
        ("halt", drop.StateTold(False)),
        ("capture", drop.Failed("refused", "the arm is parked")),
    ],
)
def test_answers_come_back(ask: drop.Ask, answer: drop.Answer) -> None:
    request = drop.Request(8, ask)
    assert drop.decode_request(drop.encode_request(request)) == request
    assert drop.decode_answer(drop.encode_answer(8, answer), request) == answer


@pytest.mark.parametrize(
    ("old", "young", "place"),
    [
        (b'"request": 17', b'"request": 16', "request"),
        (b"00000017.npz", b"../../secret", "file"),
        (b"00000017.npz", b"00000016.npz", "file"),
        (b'"age_s": 0.5', b'"age_s": NaN', "age_s"),
        (b'"age_s": 0.5', b'"age_s": -1', "age_s"),
        (b'"bytes": 1000', b'"bytes": 1e3', "bytes"),
        (b'"bytes": 1000', b'"bytes": 99999999999', "bytes"),
        (b"[2, 3]", b"[2, 0]", "shape"),
        (b"[2, 3]", b"[2, 3, 3]", "shape"),
        (b'"ok": true', b'"ok": 1', "ok"),
        (b'"frame_id": 5, ', b"", "frame_id"),
        (b'"ok": true', b'"ok": false', "error"),
        (b"{", b"[{", "file"),
    ],
)
def test_a_wrong_answer_names_its_place(old: bytes, young: bytes, place: str) -> None:
    with pytest.raises(drop.ScanDropError) as caught:
        drop.decode_answer(ANSWER.replace(old, young, 1), CAPTURE)
    assert caught.value.place == place


KINDS = ("npz", "npy", "ply", "pcd")
TABLES = ("ply", "pcd")


def cloud(shape: tuple[int, int] = (4, 6), seed: int = 1) -> NDArray[np.float32]:
    return np.random.default_rng(seed).normal(size=(*shape, 3)).astype(np.float32)


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def text(kind: str, points: NDArray[np.float32], line: str = "{} {} {}") -> bytes:
    """A file as text, by hand; `line` is what stands for a point."""
    rows, columns = points.shape[:2]
    body = "".join(line.format(*(repr(float(one)) for one in point)) + "\n" for point in points.reshape(-1, 3))
    names = ("a", "x", "y", "z")[0 if line.startswith("7") else 1 :]
    if kind == "ply":
        properties = "".join(f"property float {name}\n" for name in names)
        head = f"ply\nformat ascii 1.0\ncomment by hand\nelement vertex {rows * columns}\n{properties}end_header\n"
    else:
        head = f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE{' 4' * len(names)}\nTYPE{' F' * len(names)}\n"
        head += f"WIDTH {columns}\nHEIGHT {rows}\nPOINTS {rows * columns}\nDATA ascii\n"
    return (head + body).encode()


def told(data: bytes, shape: tuple[int, int] = (4, 6), kind: str = "npz") -> drop.FrameTold:
    return drop.FrameTold(1, "rotor", "mm", 0.0, f"00000001.{kind}", len(data), shape)


def test_clouds_come_back() -> None:
    points = cloud()
    points[0, 0] = np.nan
    for data, kind in ((drop.encode_cloud(points), "npz"), (npz(points=points), "npz"), (npy(points), "npy")):
        back = drop.decode_cloud(data, told(data, kind=kind))
        assert back.dtype == np.float32
        assert np.array_equal(back, points, equal_nan=True)
        assert back.flags.writeable
    wide = npy(points.astype(np.float64))
    assert np.array_equal(drop.decode_cloud(wide, told(wide, kind="npy")), points, equal_nan=True)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_comes_back_and_wider_numbers_too(kind: Any) -> None:
    points = cloud()
    points[0, 0] = np.nan
    data = drop.encode_cloud(points, kind)
    back = drop.decode_cloud(data, told(data, kind=kind))
    assert back.dtype == np.float32
    assert np.array_equal(back, points, equal_nan=True)
    assert back.flags.writeable


def test_the_headers_of_tables_are_these_bytes() -> None:
    points = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    assert drop.encode_cloud(points, "ply") == (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 6\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n" + points.astype("<f4").tobytes()
    )
    assert drop.encode_cloud(points, "pcd") == (
        b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 2\n"
        b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA binary\n" + points.astype("<f4").tobytes()
    )


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("line", ["{} {} {}", "7 {} {} {}"])
def test_tables_as_text_with_other_columns_are_read(kind: str, line: str) -> None:
    points = cloud()
    points[2, 3] = np.nan
    data = text(kind, points, line)
    assert np.array_equal(drop.decode_cloud(data, told(data, kind=kind)), points, equal_nan=True)


def test_a_ply_file_of_doubles_in_network_order_with_a_colour_is_read() -> None:
    points, record = cloud(), np.dtype([("r", "u1"), ("x", ">f8"), ("z", ">f8"), ("y", ">f8")])
    rows = np.zeros(24, record)
    for axis, name in enumerate("xyz"):
        rows[name] = points[..., axis].ravel()
    head = "".join(f"property {kind} {name}\n" for kind, name in (("uchar", "r"), *(("double", n) for n in "xzy")))
    data = f"ply\nformat binary_big_endian 1.0\nelement vertex 24\n{head}end_header\n".encode() + rows.tobytes()
    assert np.array_equal(drop.decode_cloud(data, told(data, kind="ply")), points)


def test_a_pcd_file_may_fill_its_last_page_with_zeros_and_nothing_else() -> None:
    data = drop.encode_cloud(cloud(), "pcd")
    padded = data + bytes(100)
    assert np.array_equal(drop.decode_cloud(padded, told(padded, kind="pcd")), cloud())
    more = data + cloud()[0, 0].tobytes()
    with pytest.raises(drop.ScanDropError, match="half a frame"):
        drop.decode_cloud(more, told(more, kind="pcd"))


def test_a_point_that_is_not_finite_in_one_coordinate_is_none() -> None:
    points = cloud()
    points[1, 2, 0] = np.inf
    points[3, 5, 2] = np.nan
    data = drop.encode_cloud(points)
    back = drop.decode_cloud(data, told(data))
    assert np.isnan(back[1, 2]).all()
    assert np.isnan(back[3, 5]).all()
    assert np.isfinite(back).sum() == 3 * (4 * 6 - 2)


@pytest.mark.parametrize("kind", [*KINDS, "ply text", "pcd text"])
@given(share=st.floats(0.0, 0.999))
def test_half_a_file_is_no_cloud(kind: Any, share: float) -> None:
    data = text(kind[:3], cloud()) if "text" in kind else drop.encode_cloud(cloud(), kind)
    kind = kind[:3]
    part = data[: int(share * len(data))]
    with pytest.raises(drop.ScanDropError, match="half a frame"):
        drop.decode_cloud(part, told(data, kind=kind))
    with pytest.raises(drop.ScanDropError):
        drop.decode_cloud(part, told(part, kind=kind))


@pytest.mark.parametrize("kind", [*KINDS, "ply text", "pcd text"])
@given(st.data())
def test_a_mutated_file_is_refused_or_still_a_cloud_of_its_shape(kind: Any, data: st.DataObject) -> None:
    whole = bytearray(text(kind[:3], cloud()) if "text" in kind else drop.encode_cloud(cloud(), kind))
    kind = kind[:3]
    header = st.integers(0, min(len(whole) - 1, 200))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(header if data.draw(st.booleans()) else st.integers(0, len(whole) - 1))
        whole[at] = data.draw(st.integers(0, 255))
    try:
        back = drop.decode_cloud(bytes(whole), told(bytes(whole), kind=kind))
    except drop.ScanDropError:
        return
    assert back.shape == (4, 6, 3)


PLY, PCD = drop.encode_cloud(cloud(), "ply"), drop.encode_cloud(cloud(), "pcd")
OBJECTS = np.array([[[{}, {}, {}]]], dtype=object)


@pytest.mark.parametrize(
    ("data", "kind", "reason"),
    [
        (npz(other=cloud()), "npz", "no array called points"),
        (npz(points=cloud((4, 5))), "npz", "half a frame"),
        (npy(OBJECTS), "npy", "O"),
        (npy(cloud().astype(np.int32)), "npy", "i4"),
        (npy(np.asfortranarray(cloud())), "npy", "True"),
        (npy(cloud().reshape(-1, 3)), "npy", "24, 3"),
        (b"ply\nformat ascii 1.0\n", "npz", "no readable NPZ"),
        (b"", "npy", "no readable NPY"),
        (b"", "ply", "header does not end"),
        (PCD, "ply", "header does not end"),
        (b"x\n" + PLY, "ply", "no PLY file"),
        (PLY.replace(b"vertex 24", b"vertex 23"), "ply", "23 points"),
        (PLY.replace(b"float z", b"float w"), "ply", "not named once"),
        (PLY.replace(b"float z", b"float x"), "ply", "not named once"),
        (PLY.replace(b"float z", b"int z"), "ply", "no floating-point"),
        (PLY.replace(b"property float x", b"property list uchar int x"), "ply", "without lists"),
        (PLY.replace(b"end_header", b"element face 0\nend_header"), "ply", "one element vertex"),
        (PLY.replace(b"binary_little", b"binary_middle"), "ply", "header line"),
        (PCD.replace(b"HEIGHT 4", b"HEIGHT 1").replace(b"WIDTH 6", b"WIDTH 24"), "pcd", "1 rows of 24"),
        (PCD.replace(b"DATA binary", b"DATA binary_compressed"), "pcd", "is not read"),
        (PCD.replace(b"COUNT 1 1 1", b"COUNT 1 1 2"), "pcd", "numbers, one for each"),
        (PCD.replace(b"TYPE F F F", b"TYPE F F"), "pcd", "numbers, one for each"),
        (PCD.replace(b"TYPE F F F", b"TYPE I I I"), "pcd", "no floating-point"),
        (PCD.replace(b"POINTS 24\n", b""), "pcd", "misses POINTS"),
        (text("ply", cloud()).replace(b"\n-", b"\nno", 1), "ply", "no table"),
    ],
)
def test_what_is_no_organised_cloud_is_refused(data: bytes, kind: str, reason: str) -> None:
    with pytest.raises(drop.ScanDropError, match=reason):
        drop.decode_cloud(data, told(data, kind=kind))


def test_a_header_that_promises_more_than_comes_takes_no_memory() -> None:
    small, huge = npy(cloud()), b"'shape': (60000, 60000, 3)"
    data = small.replace(b"'shape': (4, 6, 3), }" + b" " * (len(huge) - 18), huge + b", }")
    assert data != small
    assert len(data) == len(small)
    with pytest.raises(drop.ScanDropError, match="half a frame"):
        drop.decode_cloud(data, told(data, (60000, 60000), "npy"))


def test_a_packed_file_that_is_huge_unpacked_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cloud_arrays, "LARGEST_FILE", 10_000)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("points.npy", b"\0" * 1_000_000)
    data = file.getvalue()
    with pytest.raises(drop.ScanDropError, match="unpacked"):
        drop.decode_cloud(data, told(data))
