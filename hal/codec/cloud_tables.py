"""Organised clouds in PLY (Turk, Stanford 1994) and PCD 0.7 (Point Cloud Library): a header as text, then a table.

A PLY file knows no rows and columns, so they are told beside it; its vertices stand row by row. Only what a scanner
writes is read: one element ``vertex`` without lists, PCD data ``ascii`` or ``binary``. Errors are CodecError.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.codec.errors import CodecError

LONGEST_HEADER = 1 << 16
_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_PCD_TYPES = {"F4": "f4", "F8": "f8", **{f"{sign}{size}": f"{sign.lower()}{size}" for sign in "IU" for size in "1248"}}
_PCD_KEYS = ("FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "POINTS", "DATA")


@dataclass(frozen=True, slots=True)
class _Table:
    """What a header says: column names and types, rows, and the byte order, "" for text."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    rows: int
    order: str


def encode_ply(points: NDArray[np.float32]) -> bytes:
    """Binary, little-endian, row by row."""
    count = points.shape[0] * points.shape[1]
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n"
    return header.encode() + points.astype("<f4").tobytes()


def encode_pcd(points: NDArray[np.float32]) -> bytes:
    """Binary, as the Point Cloud Library writes it."""
    rows, columns = points.shape[:2]
    header = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {columns}\nHEIGHT {rows}\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {rows * columns}\nDATA binary\n"
    )
    return header.encode() + points.astype("<f4").tobytes()


def decode_ply(data: bytes, place: str, shape: tuple[int, int]) -> NDArray[Any]:
    """(H, W, 3) of `shape`, which is told."""
    lines, start = _header(data, place, b"end_header")
    if lines[:1] != ["ply"]:
        raise CodecError(place, "is no PLY file")
    names, kinds, order, rows = list[str](), list[str](), None, None
    for line in lines[1:]:
        match line.split():
            case [] | ["comment" | "obj_info" | "end_header", *_]:
                pass
            case ["format", layout, "1.0"] if order is None and layout in _PLY_ORDERS:
                order = _PLY_ORDERS[layout]
            case ["element", "vertex", count] if rows is None and count.isdigit():
                rows = int(count)
            case ["property", kind, name] if rows is not None and kind in _PLY_TYPES:
                names.append(name)
                kinds.append(_PLY_TYPES[kind])
            case _:
                raise CodecError(place, f"PLY header line {line[:60]!r}: one element vertex without lists is needed")
    if order is None or rows is None:
        raise CodecError(place, "the PLY header names no format or no vertices")
    return _points(data[start:], _Table(tuple(names), tuple(kinds), rows, order), place, shape)


def decode_pcd(data: bytes, place: str, shape: tuple[int, int]) -> NDArray[Any]:
    """(H, W, 3); `shape` must be the header's own."""
    lines, start = _header(data, place, b"DATA ")
    said = {words[0]: words[1:] for line in lines if (words := line.split()) and not words[0].startswith("#")}
    said.setdefault("COUNT", ["1"] * len(said.get("FIELDS", [])))
    if missing := [key for key in _PCD_KEYS if not said.get(key)]:
        raise CodecError(place, f"the PCD header misses {', '.join(missing)}")
    names = said["FIELDS"]
    kinds = [_PCD_TYPES.get(kind + size, "") for kind, size in zip(said["TYPE"], said["SIZE"], strict=False)]
    if said["COUNT"] != ["1"] * len(names) or len(kinds) != len(names) or "" in kinds:
        raise CodecError(place, f"PCD fields {names[:9]} of types {kinds[:9]}: numbers, one for each field, are needed")
    rows, columns = said["HEIGHT"][0], said["WIDTH"][0]
    if [rows, columns, said["POINTS"][0]] != [str(shape[0]), str(shape[1]), str(math.prod(shape))]:
        raise CodecError(place, f"half a frame: {rows} rows of {columns}, told was {shape}")
    orders = {"ascii": "", "binary": "<"}
    if (layout := said["DATA"][0]) not in orders:
        raise CodecError(place, f"PCD data {layout!r} is not read: ascii or binary is needed")
    return _points(data[start:], _Table(tuple(names), tuple(kinds), math.prod(shape), orders[layout]), place, shape)


def _header(data: bytes, place: str, last: bytes) -> tuple[list[str], int]:
    """Lines of the header, and where the table begins: after the line that begins with `last`."""
    at = 0 if data.startswith(last) else data.find(b"\n" + last, 0, LONGEST_HEADER) + 1
    end = data.find(b"\n", at, LONGEST_HEADER) + 1
    if (at == 0 and not data.startswith(last)) or end == 0:
        raise CodecError(place, "half a frame: its header does not end")
    return data[:end].decode("ascii", "replace").splitlines(), end


def _points(body: bytes, table: _Table, place: str, shape: tuple[int, int]) -> NDArray[Any]:
    if any(table.names.count(axis) != 1 for axis in "xyz"):
        raise CodecError(place, f"x, y and z are not named once each among {list(table.names)[:9]}")
    if any(table.kinds[table.names.index(axis)][0] != "f" for axis in "xyz"):
        raise CodecError(place, "x, y and z are no floating-point numbers")
    if table.rows != math.prod(shape):
        raise CodecError(place, f"half a frame: {table.rows} points, told were {shape[0]} rows of {shape[1]}")
    columns = _text(body, table, place) if not table.order else _binary(body, table, place)
    return np.stack([columns[table.names.index(axis)] for axis in "xyz"], axis=-1).reshape(*shape, 3)


def _text(body: bytes, table: _Table, place: str) -> list[NDArray[Any]]:
    """A last line without its end may have lost digits."""
    if not body.endswith((b"\n", b"\r")):
        raise CodecError(place, "half a frame: its last line does not end")
    try:
        values = np.loadtxt(io.BytesIO(body), dtype=np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise CodecError(place, f"is no table of numbers ({error})") from None
    if values.shape != (table.rows, len(table.names)):
        wanted = (table.rows, len(table.names))
        raise CodecError(place, f"half a frame: lines and columns {values.shape}, announced {wanted}")
    return list(values.T)


def _binary(body: bytes, table: _Table, place: str) -> list[NDArray[Any]]:
    """Zeros may follow where the writer fills its last page."""
    record = np.dtype([(str(at), table.order + kind) for at, kind in enumerate(table.kinds)])
    needed = table.rows * record.itemsize
    if len(body) < needed or body[needed:].strip(b"\0"):
        raise CodecError(place, f"half a frame: {len(body)} bytes for {table.rows} points of {record.itemsize}")
    rows = np.frombuffer(body, record, table.rows)
    return [rows[str(at)] for at in range(len(table.names))]
