"""PLY, ascii or binary of either endianness, as Turk defined it (Stanford, 1994)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellctl.vision.formats.limits import (
    Coordinates,
    count_of,
    ends_here,
    ends_with_a_line,
    numbers,
    points_of,
    xyz_places,
)

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class _Property:
    """A property of the header; `length` is the type of a list's length, "" where it is no list."""

    name: str
    kind: str
    length: str = ""


@dataclass(frozen=True, slots=True)
class _Element:
    """An element of the header."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        """Whether its rows may differ in length."""
        return any(item.length for item in self.properties)

    @property
    def places(self) -> tuple[int, int, int]:
        """Where x, y and z stand. Raises ValueError where they do not, or rows differ in length."""
        if self.has_lists:
            raise ValueError(f"the {self.name} element has lists, which are not understood there")
        return xyz_places([item.name for item in self.properties])

    def record(self, order: str) -> np.dtype[np.void]:
        """Layout of a row without lists; fields are numbered, because names may repeat."""
        return np.dtype([(str(i), order + item.kind) for i, item in enumerate(self.properties)])


def read_ply(data: bytes) -> Coordinates:
    """Vertices (N, 3) of a PLY file. Elements before and after the vertices are checked for length."""
    end = data.find(b"\nend_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header")
    newline = data.find(b"\n", end + 1)
    if newline < 0:
        raise ValueError("the PLY header does not end")
    order, elements = _header(data[:end].decode("ascii", errors="replace"))
    if [element.name for element in elements].count("vertex") != 1:
        raise ValueError("the PLY file does not have vertices once")
    body = memoryview(data)[newline + 1 :]
    return _ascii(bytes(body), elements) if not order else _binary(body, elements, order)


def _header(text: str) -> tuple[str, list[_Element]]:
    """Byte order ("" for ascii) and elements."""
    order: str | None = None
    elements: list[_Element] = []
    for line in text.splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and order is None:
            order = _ORDERS.get(words[1])
        elif words[0] == "element" and len(words) == 3 and words[2].isdigit():
            elements.append(_Element(words[1], count_of(words[2])))
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_property(words[1:], line))
        else:
            raise ValueError(f"PLY header line not understood: '{line[:60]}'")
    if order is None:
        raise ValueError("the PLY header names no known format")
    return order, elements


def _property(words: list[str], line: str) -> _Property:
    if len(words) == 2 and words[0] in _TYPES:
        return _Property(words[1], _TYPES[words[0]])
    if len(words) == 4 and words[0] == "list" and {words[1], words[2]} <= _TYPES.keys() and _TYPES[words[1]][0] != "f":
        return _Property(words[3], _TYPES[words[2]], _TYPES[words[1]])
    raise ValueError(f"PLY header line not understood: '{line[:60]}'")


def _ascii(body: bytes, elements: list[_Element]) -> Coordinates:
    ends_with_a_line(body)
    body = body.rstrip() + b"\n"
    ends = np.flatnonzero(np.frombuffer(body, dtype=np.uint8) == ord("\n")) + 1
    needed = sum(element.count for element in elements)
    if needed and len(ends) != needed:
        raise ValueError(f"{needed} lines announced, {len(ends)} found")
    at = [element.name for element in elements].index("vertex")
    vertex, before = elements[at], sum(element.count for element in elements[:at])
    places = vertex.places
    if not vertex.count:
        return np.empty((0, 3), dtype=np.float32)
    first = int(ends[before - 1]) if before else 0
    table = numbers(body[first : int(ends[before + vertex.count - 1])], len(vertex.properties), vertex.count)
    return points_of([table[:, place] for place in places])


def _binary(body: memoryview, elements: list[_Element], order: str) -> Coordinates:
    offset, record = 0, 1
    points = np.empty((0, 3), dtype=np.float32)
    for element in elements:
        places = element.places if element.name == "vertex" else None
        if element.has_lists:
            offset = _after_lists(body, element, offset, order)
            continue
        layout = element.record(order)
        record = layout.itemsize
        if len(body) < offset + element.count * record:
            left = len(body) - offset
            raise ValueError(f"truncated: {element.name} needs {element.count * record} bytes, {left} found")
        if places is not None:
            rows = np.frombuffer(body, layout, element.count, offset)
            points = points_of([rows[str(place)] for place in places])
        offset += element.count * record
    ends_here(body[offset:], record)
    return points


def _after_lists(body: memoryview, element: _Element, offset: int, order: str) -> int:
    """Where an element with lists ends. Raises ValueError where that is beyond the file."""
    for row in range(element.count):
        end, lengths = _row(body, element, offset, order)
        if row == 0 and _alike(body, offset, end - offset, element.count, lengths):
            return offset + element.count * (end - offset)
        offset = end
    return offset


def _row(body: memoryview, element: _Element, start: int, order: str) -> tuple[int, list[tuple[int, np.dtype, int]]]:
    """End of the row at `start`, and of each list in it the place in the row, the type and the value of its length."""
    at = start
    lengths: list[tuple[int, np.dtype, int]] = []
    for item in element.properties:
        size = np.dtype(item.kind).itemsize
        if not item.length:
            at += size
            continue
        kind = np.dtype(order + item.length)
        items = int(np.frombuffer(body[at : at + kind.itemsize], kind)[0]) if at + kind.itemsize <= len(body) else -1
        if items < 0:
            break
        lengths.append((at - start, kind, items))
        at += kind.itemsize + items * size
    else:
        if at <= len(body):
            return at, lengths
    raise ValueError(f"truncated: the {element.name} element ends after the file")


def _alike(body: memoryview, start: int, stride: int, count: int, lengths: list[tuple[int, np.dtype, int]]) -> bool:
    """Whether all rows are as long as the first, which faces mostly are."""
    if start + count * stride > len(body):
        return False
    return all((np.ndarray(count, kind, body, start + at, stride) == items).all() for at, kind, items in lengths)
