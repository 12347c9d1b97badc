"""Bytes of PLY, PCD and XYZ files to points. Headers are strict and lengths are checked: a truncated file is an error.

Each reader gives (N, 3), or (H, W, 3) for an organised PCD, and raises ValueError with a reason.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MAX_POINTS = 50_000_000

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def read_ply(data: bytes) -> Array:
    """Vertices (N, 3) of a PLY file, ascii or binary. Elements before and after the vertices are checked for length."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header")
    newline = data.find(b"\n", end)
    if newline < 0:
        raise ValueError("the PLY header does not end")
    layout, elements = _ply_header(data[:end].decode("ascii", errors="replace"))
    body = data[newline + 1 :]
    vertex = next((item for item in elements if item[0] == "vertex"), None)
    if vertex is None or not {"x", "y", "z"} <= {name for name, _ in vertex[2]}:
        raise ValueError("the PLY file has no vertices with x, y, z")
    return _ply_ascii(body, elements) if layout == "ascii" else _ply_binary(body, elements, layout)


Element = tuple[str, int, list[tuple[str, str]]]


def _ply_header(text: str) -> tuple[str, list[Element]]:
    layout = ""
    elements: list[Element] = []
    for line in text.splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3:
            layout = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1], "")
        elif words[0] == "element" and len(words) == 3 and words[2].isdigit():
            elements.append((words[1], _count(words[2]), []))
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _PLY_TYPES:
            elements[-1][2].append((words[2], _PLY_TYPES[words[1]]))
        elif words[0] == "property" and elements and len(words) == 5 and words[1] == "list":
            elements[-1][2].append((words[4], "list"))
        else:
            raise ValueError(f"PLY header line not understood: '{line[:60]}'")
    if not layout:
        raise ValueError("the PLY header names no known format")
    return layout, elements


def _ply_ascii(body: bytes, elements: list[Element]) -> Array:
    _ends_with_a_line(body)
    lines = [line for line in body.split(b"\n") if line.strip()]
    needed = sum(item[1] for item in elements)
    if len(lines) < needed:
        raise ValueError(f"truncated: {needed} lines announced, {len(lines)} found")
    start = 0
    for name, count, properties in elements:
        if name != "vertex":
            start += count
            continue
        rows = lines[start : start + count]
        width = len(properties)
        values = np.array(b" ".join(rows).split(), dtype=np.float64)
        if values.size != count * width:
            raise ValueError(f"vertices: {count * width} numbers announced, {values.size} found")
        return _columns(values.reshape(count, width), [item[0] for item in properties])
    raise ValueError("no vertices")


def _ply_binary(body: bytes, elements: list[Element], order: str) -> Array:
    offset, vertices = 0, None
    for name, count, properties in elements:
        if any(kind == "list" for _, kind in properties):
            if vertices is None:
                raise ValueError("a list before the vertices is not understood")
            break
        record = np.dtype([(f"{i}:{field}", order + kind) for i, (field, kind) in enumerate(properties)])
        if len(body) < offset + count * record.itemsize:
            raise ValueError(f"truncated: {name} needs {count * record.itemsize} bytes, {len(body) - offset} found")
        if name == "vertex":
            rows = np.frombuffer(body, record, count, offset)
            names = [field for field, _ in properties]
            columns = [rows[f"{names.index(axis)}:{axis}"] for axis in "xyz"]
            vertices = np.stack(columns, axis=1).astype(np.float64)
        offset += count * record.itemsize
    if vertices is None:
        raise ValueError("no vertices")
    return vertices


def read_pcd(data: bytes) -> Array:
    """Points of a PCD file (ascii, binary, binary_compressed): (N, 3), or (H, W, 3) where HEIGHT is above 1."""
    header, body = _pcd_header(data)
    names, counts = header["FIELDS"], [int(item) for item in header.get("COUNT", ["1"] * len(header["FIELDS"]))]
    if not {"x", "y", "z"} <= set(names) or not len(names) == len(counts) == len(header["SIZE"]) == len(header["TYPE"]):
        raise ValueError("the PCD header has no x, y, z or its field lists differ in length")
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)]
    if any(kind[1] not in "fiu" or kind[2:] not in "1248" for kind in kinds):
        raise ValueError("the PCD header names an unknown type")
    points = _count(header["POINTS"][0])
    width, height = _count(header["WIDTH"][0]), _count(header["HEIGHT"][0])
    if width * height != points:
        raise ValueError(f"WIDTH {width} x HEIGHT {height} is not POINTS {points}")
    layout = header["DATA"][0]
    if layout == "ascii":
        _ends_with_a_line(body)
        values = np.array(body.split(), dtype=np.float64)
        if values.size != points * sum(counts):
            raise ValueError(f"truncated: {points * sum(counts)} numbers announced, {values.size} found")
        starts = np.cumsum([0, *counts])[:-1]
        table = values.reshape(points, sum(counts))
        result = np.stack([table[:, starts[names.index(axis)]] for axis in "xyz"], axis=1)
    elif layout in ("binary", "binary_compressed"):
        result = _pcd_binary(body, names, kinds, counts, points, compressed=layout == "binary_compressed")
    else:
        raise ValueError(f"PCD data '{layout}' is unknown")
    return result.reshape(height, width, 3) if height > 1 else result


def _pcd_header(data: bytes) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    offset = 0
    while "DATA" not in header:
        newline = data.find(b"\n", offset)
        if newline < 0 or newline - offset > 10_000:
            raise ValueError("the PCD header does not end")
        words = data[offset:newline].decode("ascii", errors="replace").split()
        offset = newline + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    missing = {"FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "POINTS"} - {key for key, value in header.items() if value}
    if missing or not header["DATA"]:
        raise ValueError(f"the PCD header misses {sorted(missing) or ['DATA']}")
    return header, data[offset:]


def _pcd_binary(
    body: bytes, names: list[str], kinds: list[str], counts: list[int], points: int, *, compressed: bool
) -> Array:
    sizes = [np.dtype(kind).itemsize * count for kind, count in zip(kinds, counts, strict=True)]
    if compressed:  # fields one after the other, LZF
        if len(body) < 8:
            raise ValueError("truncated: no sizes of the compressed data")
        packed, full = (int(value) for value in np.frombuffer(body, "<u4", 2))
        if len(body) < 8 + packed or full != points * sum(sizes):
            raise ValueError("truncated: the compressed data does not have the announced size")
        body = lzf_decompress(body[8 : 8 + packed], full)
        starts = np.cumsum([0, *sizes])[:-1] * points
        columns: list[NDArray[Any]] = []
        for axis in "xyz":
            at = names.index(axis)
            columns.append(np.frombuffer(body, kinds[at], points * counts[at], int(starts[at]))[:: counts[at]])
        return np.stack(columns, axis=1).astype(np.float64)
    record = np.dtype([(str(i), kind, (count,)) for i, (kind, count) in enumerate(zip(kinds, counts, strict=True))])
    if len(body) < points * record.itemsize:
        raise ValueError(f"truncated: {points * record.itemsize} bytes announced, {len(body)} found")
    rows = np.frombuffer(body, record, points)
    return np.stack([rows[str(names.index(axis))][:, 0] for axis in "xyz"], axis=1).astype(np.float64)


def lzf_decompress(data: bytes, size: int) -> bytes:
    """`size` bytes out of an LZF stream (literal runs and back references). Raises ValueError where it is broken."""
    out = bytearray()
    at = 0
    try:
        while at < len(data):
            control = data[at]
            at += 1
            if control < 32:
                run = data[at : at + control + 1]
                if len(run) != control + 1:
                    raise ValueError("the compressed data ends inside a run")
                out += run
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            length += 2
            if start < 0 or len(out) + length > size:
                raise ValueError("the compressed data refers outside itself")
            step = len(out) - start
            piece = bytes(out[start : start + length])
            out += (piece * (length // step + 1))[:length]  # an overlapping reference repeats itself
    except IndexError:
        raise ValueError("the compressed data ends too early") from None
    if len(out) != size:
        raise ValueError(f"the compressed data gives {len(out)} bytes, {size} announced")
    return bytes(out)


def read_xyz(data: bytes) -> Array:
    """Points (N, 3) of a text file: x y z a line, further columns ignored, comments after '#'."""
    rows = [line.split(b"#")[0].replace(b",", b" ").split() for line in data.splitlines()]
    rows = [row for row in rows if row]
    if not rows:
        raise ValueError("the file is empty")
    width = len(rows[0])
    if width < 3 or any(len(row) != width for row in rows):
        raise ValueError("lines differ in length or have fewer than three numbers")
    return np.array(rows, dtype=np.float64)[:, :3]


def _ends_with_a_line(body: bytes) -> None:
    """A text that stops inside a line may have lost digits of its last number, which nothing else would show."""
    if not body.endswith((b"\n", b"\r")):
        raise ValueError("truncated: the last line does not end")


def _columns(table: Array, names: list[str]) -> Array:
    return np.stack([table[:, names.index(axis)] for axis in "xyz"], axis=1)


def _count(text: str) -> int:
    value = int(text)
    if not 0 <= value <= MAX_POINTS:
        raise ValueError(f"{value} points are not plausible")
    return value
