"""Files become clouds, or an error that names the reason; never a cloud that was cut short."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from cellctl.vision.cloud import Unreadable, as_cloud, load_cloud
from cellctl.vision.formats import lzf_decompress, read_pcd, read_ply
from cellctl.vision.part import Refused


def write(tmp_path: Path, name: str, data: bytes) -> Path:
    path = tmp_path / name
    path.write_bytes(data)
    return path


ROWS, COLUMNS = np.mgrid[0:20, 0:25].reshape(2, -1)
POINTS = np.column_stack([3.0 * COLUMNS, 3.0 * ROWS, 350.0 + 0.1 * np.sin(ROWS)]).astype(np.float32)
COUNT = len(POINTS)
PLY = (
    f"ply\nformat {{}} 1.0\nelement vertex {COUNT}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
)
PCD = (
    f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {COUNT}\nHEIGHT 1\n"
    f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {COUNT}\nDATA {{}}\n"
)
TEXT = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in POINTS).encode() + b"\n"
RAW = POINTS.astype("<f4").tobytes()


def lzf_literal(data: bytes) -> bytes:
    """LZF stream of literal runs only."""
    return b"".join(bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32] for i in range(0, len(data), 32))


def packed() -> bytes:
    columns = POINTS.astype("<f4").T.tobytes()
    stream = lzf_literal(columns)
    return struct.pack("<II", len(stream), len(columns)) + stream


FILES = {
    "ascii.ply": PLY.format("ascii").encode() + TEXT,
    "little.ply": PLY.format("binary_little_endian").encode() + RAW,
    "big.ply": PLY.format("binary_big_endian").encode() + POINTS.astype(">f4").tobytes(),
    "ascii.pcd": PCD.format("ascii").encode() + TEXT,
    "binary.pcd": PCD.format("binary").encode() + RAW,
    "packed.pcd": PCD.format("binary_compressed").encode() + packed(),
    "plain.xyz": b"# three columns\n" + TEXT,
}


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_points(tmp_path: Path, name: str) -> None:
    cloud = load_cloud(write(tmp_path, name, FILES[name]))
    assert not cloud.organised
    assert cloud.valid == COUNT
    assert np.array_equal(cloud.points, POINTS)


@pytest.mark.parametrize("name", sorted(set(FILES) - {"plain.xyz"}))  # plain text does not say where it ends
@pytest.mark.parametrize("keep", [0.0, 0.01, 0.05, 0.5, 0.95, 0.999])
def test_a_file_cut_short_is_unreadable(tmp_path: Path, name: str, keep: float) -> None:
    data = FILES[name]
    with pytest.raises((Unreadable, Refused)):
        load_cloud(write(tmp_path, name, data[: int(len(data) * keep)]))


def test_numpy_files(tmp_path: Path) -> None:
    grid = POINTS.reshape(20, -1, 3)
    np.save(tmp_path / "a.npy", grid)
    np.savez_compressed(tmp_path / "b.npz", points=grid, other=np.zeros(3))
    assert load_cloud(tmp_path / "a.npy").organised
    assert np.array_equal(load_cloud(tmp_path / "b.npz").points, grid)
    np.savez(tmp_path / "c.npz", one=grid, two=grid)
    np.save(tmp_path / "d.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.save(tmp_path / "e.npy", POINTS[:, :2])
    (tmp_path / "f.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-100])
    (tmp_path / "g.npz").write_bytes((tmp_path / "b.npz").read_bytes()[:-200])
    for name in ("c.npz", "d.npy", "e.npy", "f.npy", "g.npz", "absent.npy"):
        with pytest.raises(Unreadable):
            load_cloud(tmp_path / name)


@pytest.mark.parametrize("name", ["cloud.stl", "cloud"])
def test_unknown_kind(tmp_path: Path, name: str) -> None:
    with pytest.raises(Unreadable, match="unknown kind"):
        load_cloud(write(tmp_path, name, b"x"))


@pytest.mark.parametrize(
    "header",
    [
        b"ply\nformat ascii 9.0 x\nend_header\n",
        b"ply\nelement vertex 3\nproperty float x\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex -3\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty quark x\nend_header\n1\n",
        b"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int i\nend_header\n3 0 1 2\n",
        b"plx",
    ],
)
def test_broken_ply_headers(header: bytes) -> None:
    with pytest.raises(ValueError):
        read_ply(header)


def test_elements_beside_the_vertices_are_stepped_over() -> None:
    header = (
        b"ply\nformat binary_little_endian 1.0\nelement camera 1\nproperty double f\nelement vertex 2\n"
        b"property uchar red\nproperty float z\nproperty float y\nproperty float x\n"
        b"element face 1\nproperty list uchar int v\nend_header\n"
    )
    rows = struct.pack("<d", 1.0) + struct.pack("<Bfff", 9, 3.0, 2.0, 1.0) + struct.pack("<Bfff", 9, 6.0, 5.0, 4.0)
    face = struct.pack("<Biii", 3, 0, 1, 1)
    assert read_ply(header + rows + face).tolist() == [[1, 2, 3], [4, 5, 6]]
    with pytest.raises(ValueError, match="face element ends after the file"):
        read_ply(header + rows + face[:-1])


def test_organised_pcd_keeps_its_grid() -> None:
    header = PCD.format("ascii").replace(f"WIDTH {COUNT}", f"WIDTH {COUNT // 20}").replace("HEIGHT 1\n", "HEIGHT 20\n")
    assert read_pcd(header.encode() + TEXT).shape == (20, COUNT // 20, 3)


def test_lzf_back_references() -> None:
    assert lzf_decompress(bytes([2]) + b"abc" + bytes([(3 << 5), 2]), 8) == b"abcabcab"
    assert lzf_decompress(bytes([0]) + b"a" + bytes([(7 << 5), 3, 0]), 13) == b"a" * 13
    for broken in (bytes([40]), bytes([(1 << 5), 9]), bytes([5]) + b"ab", bytes([0]) + b"a"):
        with pytest.raises(ValueError):
            lzf_decompress(broken, 8)


@pytest.mark.parametrize("seed", range(40))
def test_mutated_files_never_crash(tmp_path: Path, seed: int) -> None:
    """Bytes flipped anywhere: a cloud of finite points or a named error, nothing else."""
    rng = np.random.default_rng(seed)
    name = sorted(FILES)[seed % len(FILES)]
    data = bytearray(FILES[name])
    for at in rng.integers(0, min(len(data), 400 if seed % 2 else len(data)), 8):
        data[at] = int(rng.integers(0, 256))
    try:
        cloud = load_cloud(write(tmp_path, name, bytes(data)))
    except (Unreadable, Refused):
        return
    assert np.isfinite(cloud.points).all()


def test_what_a_cloud_must_be() -> None:
    for points, code in (
        (POINTS[:50], "too_few_points"),
        (np.full((200, 3), np.nan), "too_few_points"),
        (POINTS / 1000.0, "wrong_unit"),
        (POINTS * 1000.0, "wrong_unit"),
        (np.where(np.arange(COUNT)[:, None] == 5, np.inf, POINTS), "not_finite"),
        (np.zeros((5, 4)), "too_few_points"),
    ):
        with pytest.raises(Refused) as refused:
            as_cloud(points)
        assert refused.value.code == code


def test_nan_in_a_list_of_points_is_refused(tmp_path: Path) -> None:
    broken = POINTS.copy()
    broken[7] = np.nan
    np.save(tmp_path / "a.npy", broken)
    with pytest.raises(Refused, match="1 of"):
        load_cloud(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", broken.reshape(20, -1, 3))
    assert load_cloud(tmp_path / "b.npy").valid == COUNT - 1
