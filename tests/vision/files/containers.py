"""Points as the bytes of a file, in every form that programs write; independent of the readers on purpose."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32] | NDArray[np.float64]


def ply(points: Points, layout: str = "binary_little_endian", *, double: bool = False, extra: str = "",
        faces: int = 0, newline: str = "\n", order: str = "xyz") -> bytes:  # fmt: skip
    """`extra`: "" or "colours" (uchar red, green, blue) or "normals" (float); `faces` triangles follow the vertices."""
    kind, name = ("f8", "double") if double else ("f4", "float")
    fields = [(axis, kind, name) for axis in order]
    fields += [(item, "u1", "uchar") for item in ("red", "green", "blue")] if extra == "colours" else []
    fields += [(item, "f4", "float") for item in ("nx", "ny", "nz")] if extra == "normals" else []
    lines = ["ply", f"format {layout} 1.0", "comment made at random", f"element vertex {len(points)}"]
    lines += [f"property {name} {field}" for field, _, name in fields]
    lines += [f"element face {faces}", "property list uchar int vertex_indices"] if faces else []
    header = (newline.join([*lines, "end_header"]) + newline).encode()
    end = ">" if layout == "binary_big_endian" else "<"
    rows = np.zeros(len(points), np.dtype([(field, end + kind) for field, kind, _ in fields]))
    for axis in range(3):
        rows["xyz"[axis]] = points[:, axis]
    if layout == "ascii":
        body = text(np.column_stack([rows[field] for field, _, _ in fields]), newline=newline)
        return header + body + (f"3 0 1 2{newline}" * faces).encode()
    return header + rows.tobytes() + struct.pack(end + "Biii", 3, 0, 1, 2) * faces


def text(table: Points, *, separator: str = " ", newline: str = "\n", form: str = "%.9g") -> bytes:
    """One row a line."""
    out = io.BytesIO()
    np.savetxt(out, table, fmt=form, delimiter=separator, newline=newline)
    return out.getvalue()


def pcd(points: Points, layout: str = "binary", *, double: bool = False, extra: bool = False) -> bytes:
    """`points` (N, 3) or (H, W, 3); `extra` adds a colour, two values of padding and an index."""
    height, width = points.shape[:2] if points.ndim == 3 else (1, len(points))
    size = 8 if double else 4
    fields: list[tuple[str, int, str, int]] = [(axis, size, "F", 1) for axis in "xyz"]
    fields += [("rgb", 4, "U", 1), ("_", 1, "U", 2), ("label", 2, "I", 1)] if extra else []
    names, sizes, types, counts = ([str(value) for value in column] for column in zip(*fields, strict=True))
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE {' '.join(sizes)}\n"
        f"TYPE {' '.join(types)}\nCOUNT {' '.join(counts)}\nWIDTH {width}\nHEIGHT {height}\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {width * height}\nDATA {layout}\n"
    ).encode()
    layouts = [(name, f"<{kind.lower()}{size}", (count,)) for name, size, kind, count in fields]
    rows = np.zeros(width * height, np.dtype(layouts))
    for axis in range(3):
        rows["xyz"[axis]][:, 0] = points.reshape(-1, 3)[:, axis]
    if layout == "ascii":
        return header + text(np.column_stack([rows[name] for name in names]).astype(np.float64))
    if layout == "binary":
        return header + rows.tobytes()
    columns = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in names)
    stream = lzf(columns)
    return header + struct.pack("<II", len(stream), len(columns)) + stream


def lzf(data: bytes) -> bytes:
    """LZF with literal runs, and references for runs of a repeated byte."""
    out = bytearray()
    at = literal = 0

    def flush(end: int) -> None:
        for start in range(literal, end, 32):
            piece = data[start : min(start + 32, end)]
            out.extend(bytes([len(piece) - 1]) + piece)

    while at < len(data):
        run = 1
        while at and run < 264 and at + run <= len(data) and data[at - 1 : at - 1 + run] == data[at : at + run]:
            run += 1
        run -= 1
        if at and run >= 8:
            flush(at)
            length = run - 2
            out.extend(bytes([length << 5, 0]) if length < 7 else bytes([7 << 5, length - 7, 0]))
            at += run
            literal = at
        else:
            at += 1
    flush(len(data))
    return bytes(out)


def xyz(points: Points, *, separator: str = " ", head: Sequence[str] = (), newline: str = "\n", form: str = "%.6f",
        columns: int = 3) -> bytes:  # fmt: skip
    """`head` lines come first; columns beyond three hold ones."""
    table = np.column_stack([points, np.ones((len(points), columns - 3))])
    lines = "".join(line + newline for line in head).encode()
    return lines + text(table, separator=separator, newline=newline, form=form)


def npy(array: NDArray[np.generic]) -> bytes:
    """As numpy saves it, objects included."""
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def npz(*, packed: bool = True, **arrays: NDArray[np.generic]) -> bytes:
    """As numpy saves them."""
    out = io.BytesIO()
    (np.savez_compressed if packed else np.savez)(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()
