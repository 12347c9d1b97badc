"""PCD 0.6 and 0.7 of the Point Cloud Library: ascii, binary (little-endian) and binary_compressed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.formats.limits import (
    MAX_BYTES,
    Coordinates,
    count_of,
    ends_here,
    ends_with_a_line,
    numbers,
    points_of,
    xyz_places,
)
from cellctl.vision.formats.lzf import lzf_decompress

_TYPES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}


@dataclass(frozen=True, slots=True)
class _Header:
    """Fields (type and count of each), where x, y and z stand among them, the grid and the layout of the data."""

    kinds: list[str]
    counts: list[int]
    places: tuple[int, int, int]
    width: int
    height: int
    layout: str

    @property
    def points(self) -> int:
        """Number of points."""
        return self.width * self.height

    @property
    def sizes(self) -> list[int]:
        """Bytes of each field of a point."""
        return [int(kind[2:]) * count for kind, count in zip(self.kinds, self.counts, strict=True)]


def read_pcd(data: bytes) -> Coordinates:
    """Points of a PCD file: (N, 3), or (H, W, 3) where HEIGHT is above 1."""
    lines, offset = _lines(data)
    header = _header(lines)
    body = memoryview(data)[offset:]
    if header.layout == "ascii":
        points = _ascii(bytes(body), header)
    elif header.layout == "binary":
        points = _binary(body, header)
    elif header.layout == "binary_compressed":
        points = _compressed(body, header)
    else:
        raise ValueError(f"PCD data '{header.layout}' is unknown")
    return points.reshape(header.height, header.width, 3) if header.height > 1 else points


def _lines(data: bytes) -> tuple[dict[str, list[str]], int]:
    """Words of the header by their first one, and where the data begins."""
    header: dict[str, list[str]] = {}
    offset = 0
    while "DATA" not in header:
        newline = data.find(b"\n", offset, offset + 10_000)
        if newline < 0 or len(header) > 100:
            raise ValueError("the PCD header does not end")
        words = data[offset:newline].decode("ascii", errors="replace").split()
        offset = newline + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    missing = {"FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "POINTS", "DATA"} - {key for key in header if header[key]}
    if missing:
        raise ValueError(f"the PCD header misses {sorted(missing)}")
    return header, offset


def _header(lines: dict[str, list[str]]) -> _Header:
    names, sizes, types = lines["FIELDS"], lines["SIZE"], lines["TYPE"]
    counts = [int(item) for item in lines.get("COUNT", ["1"] * len(names))]
    if not len(names) == len(counts) == len(sizes) == len(types) or min(counts) < 1:
        raise ValueError("the PCD header's lists of fields differ in length or have a field without values")
    kinds = [f"{kind.lower()}{size}" for kind, size in zip(types, sizes, strict=True)]
    if not set(kinds) <= _TYPES:
        raise ValueError(f"the PCD header names an unknown type among {sorted(set(kinds))[:12]}")
    points, width, height = (count_of(lines[key][0]) for key in ("POINTS", "WIDTH", "HEIGHT"))
    if width * height != points:
        raise ValueError(f"WIDTH {width} x HEIGHT {height} is not POINTS {points}")
    header = _Header([f"<{kind}" for kind in kinds], counts, xyz_places(names), width, height, lines["DATA"][0])
    if points * sum(header.sizes) > MAX_BYTES:
        raise ValueError(f"{points} points of {sum(header.sizes)} bytes are not plausible")
    return header


def _ascii(body: bytes, header: _Header) -> Coordinates:
    ends_with_a_line(body)
    table = numbers(body, sum(header.counts), header.points)
    starts = np.cumsum([0, *header.counts])
    return points_of([table[:, starts[place]] for place in header.places])


def _binary(body: memoryview, header: _Header) -> Coordinates:
    fields = zip(header.kinds, header.counts, strict=True)
    record = np.dtype([(str(i), kind, (count,)) for i, (kind, count) in enumerate(fields)])
    needed = header.points * record.itemsize
    if len(body) < needed:
        raise ValueError(f"truncated: {needed} bytes announced, {len(body)} found")
    ends_here(body[needed:], record.itemsize)
    rows = np.frombuffer(body, record, header.points)
    return points_of([rows[str(place)][:, 0] for place in header.places])


def _compressed(body: memoryview, header: _Header) -> Coordinates:
    """Fields one after the other, packed with LZF."""
    if len(body) < 8:
        raise ValueError("truncated: no sizes of the compressed data")
    packed, full = (int(value) for value in np.frombuffer(body[:8], "<u4"))
    if len(body) < 8 + packed or full != header.points * sum(header.sizes):
        raise ValueError("truncated: the compressed data does not have the announced size")
    ends_here(body[8 + packed :], sum(header.sizes))
    data = lzf_decompress(bytes(body[8 : 8 + packed]), full)
    starts = np.cumsum([0, *header.sizes]) * header.points
    return points_of([_first(data, header, place, int(starts[place])) for place in header.places])


def _first(data: bytes, header: _Header, place: int, start: int) -> NDArray[np.float64]:
    """First value of a field for every point, the field's values standing together from `start` on."""
    count = header.counts[place]
    values = np.frombuffer(data, header.kinds[place], header.points * count, start)
    return np.asarray(values[::count])
