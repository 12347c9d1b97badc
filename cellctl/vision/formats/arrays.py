"""NPY and NPZ of NumPy (NEP 1), without pickles, their sizes known before anything is unpacked."""

from __future__ import annotations

import io
import lzma
import math
import struct
import tokenize
import zipfile
import zlib

import numpy as np
from numpy.lib import format as npy

from cellctl.vision.formats.limits import MAX_BYTES, MAX_POINTS, Coordinates, points_of

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_BROKEN_ZIP = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, RuntimeError, OverflowError, struct.error,
    AttributeError,
)  # fmt: skip
"""What `zipfile` raises for archives that are damaged, locked or packed in a way it does not know."""


def read_npy(data: bytes) -> Coordinates:
    """Points (N, 3) or (H, W, 3) of an NPY file of floating-point numbers."""
    file = io.BytesIO(data)
    try:
        version = npy.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"version {version} of the NPY format is for named fields, which are no cloud")
        shape, columns_first, kind = _HEADERS[version](file)
    except (SyntaxError, TypeError, tokenize.TokenError, RecursionError) as error:
        raise ValueError(f"the NPY header is not understood: {error}") from None
    if len(shape) not in (2, 3) or shape[-1] != 3 or kind.kind != "f" or min(shape) < 0:
        raise ValueError(f"an array of shape {shape} and type {kind} is no cloud (N, 3) or (H, W, 3) of real numbers")
    if kind.itemsize < 4:
        raise ValueError(f"{kind} resolves no hundredth of a millimetre: coordinates need 32 bits or more")
    count, start = math.prod(shape), file.tell()
    if count > 3 * MAX_POINTS:
        raise ValueError(f"{count // 3} points are not plausible, at most {MAX_POINTS} are read")
    if len(data) - start != count * kind.itemsize:
        raise ValueError(f"{count * kind.itemsize} bytes announced, {len(data) - start} found")
    flat = np.frombuffer(data, kind, count, start)
    array = flat.reshape(shape[::-1]).T if columns_first else flat.reshape(shape)
    return points_of([array[..., axis].reshape(-1) for axis in range(3)]).reshape(shape)


def read_npz(data: bytes) -> Coordinates:
    """The only array of an NPZ file, or the one named `points`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            if "points" not in members and len(members) != 1:
                raise ValueError(f"holds the arrays {sorted(members)[:12]}, expected one, or one named 'points'")
            member = members.get("points") or next(iter(members.values()))
            if member.file_size > min(MAX_BYTES, 3 * 16 * MAX_POINTS):
                raise ValueError(f"the array unpacks to {member.file_size} bytes, which is not plausible")
            content = archive.read(member)
    except _BROKEN_ZIP as error:
        raise ValueError(f"the archive is broken: {error}") from None
    return read_npy(content)
