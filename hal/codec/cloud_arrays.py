"""Organised clouds in NPY and NPZ files of NumPy (NEP 1), without pickles. Errors are CodecError."""

from __future__ import annotations

import io
import math
import re
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.codec.errors import CodecError

LARGEST_FILE = 1 << 30
"""Bytes of a cloud's file, packed or not."""
_NPY = re.compile(
    rb"\{'descr': *'([<>]f[48])', *'fortran_order': *False, *'shape': *\((\d{1,6}), *(\d{1,6}), *3\),? *\}\s*"
)


def encode_npz(points: NDArray[np.float32]) -> bytes:
    """The one array ``points``, not packed."""
    file = io.BytesIO()
    np.savez(file, points=points)
    return file.getvalue()


def encode_npy(points: NDArray[np.float32]) -> bytes:
    """The array."""
    file = io.BytesIO()
    np.save(file, points)
    return file.getvalue()


def decode_npz(data: bytes, place: str, shape: tuple[int, int]) -> NDArray[Any]:
    """(H, W, 3) of `shape`, which is told."""
    return decode_npy(_member(data, place), place, shape)


def decode_npy(data: bytes, place: str, shape: tuple[int, int]) -> NDArray[Any]:
    """As `decode_npz`."""
    array = _npy(data, place)
    if array.shape != (*shape, 3):
        raise CodecError(place, f"half a frame: shape {array.shape}, told was {(*shape, 3)}")
    return array


def _member(data: bytes, place: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            entry = file.getinfo("points.npy")
            if entry.file_size > LARGEST_FILE:
                raise CodecError(place, f"{entry.file_size} bytes unpacked (limit {LARGEST_FILE})")
            return file.read(entry)
    except KeyError:
        raise CodecError(place, "has no array called points") from None
    except CodecError:
        raise
    except Exception as error:  # zipfile says broken in many ways
        raise CodecError(place, f"is no readable NPZ file ({error})") from None


def _npy(data: bytes, place: str) -> NDArray[Any]:
    """The array; its header is believed only where it agrees with the bytes that follow.

    NPY format: magic, version, little-endian header length of two bytes (version 1) or four, and a dictionary as text.
    """
    width = 2 if data[6:7] == b"\x01" else 4
    start = 8 + width + int.from_bytes(data[8 : 8 + width], "little")
    if not data.startswith(b"\x93NUMPY") or start > len(data):
        raise CodecError(place, "is no readable NPY file")
    header = data[8 + width : start]
    found = _NPY.fullmatch(header)
    if found is None:
        text = header[:100].decode("latin-1").strip()
        raise CodecError(place, f"{text}: rows of columns of three float32 or float64 are needed")
    dtype, shape = np.dtype(found[1].decode()), (int(found[2]), int(found[3]), 3)
    if math.prod(shape) * dtype.itemsize != len(data) - start:
        raise CodecError(place, f"half a frame: {len(data) - start} bytes for an array {shape} of {dtype}")
    return np.frombuffer(data, dtype, offset=start).reshape(shape)
