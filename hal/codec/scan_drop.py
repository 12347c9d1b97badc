"""File drop of a scanner: requests and answers as small JSON files beside each other in one folder, and the clouds.

Every file appears whole, by renaming. The host writes ``00000017.request.json``, which the scanner's software takes
away when it begins, and the host where nobody waits any more; what was taken away before is not begun. The software
writes the cloud first and then ``00000017.answer.json``, which names it::

    {"request": 17, "ask": "capture", "view": "rotor"}         ask: identify, state, capture, halt
    {"request": 17, "ok": true, "vendor": "...", "model": "...", "serial": "...", "firmware": "..."}
    {"request": 17, "ok": true, "projecting": false}           to state and halt, which is answered once it is dark
    {"request": 17, "ok": true, "frame_id": 5, "view": "rotor", "unit": "mm", "age_s": 0.4,
     "file": "00000017.npz", "bytes": 6000512, "shape": [600, 833]}
    {"request": 17, "ok": false, "error": "refused", "reason": "..."}          error: refused, fault, interrupted

A cloud is organised, (H, W, 3) floats, not a number where nothing was measured: an ``.npy`` file, or an ``.npz`` file
with the one array ``points``. PLY and PCD are not read here; a scanner that writes them needs a converter beside it.
"""

from __future__ import annotations

import io
import json
import math
import re
import zipfile
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hal.codec.errors import CodecError

Ask = Literal["identify", "state", "capture", "halt"]
Failure = Literal["refused", "fault", "interrupted"]

LARGEST_FILE = 1 << 30
"""Bytes of a cloud's file, packed or not."""
LARGEST_ANSWER = 1 << 16
_NPY = re.compile(
    rb"\{'descr': *'([<>]f[48])', *'fortran_order': *False, *'shape': *\((\d{1,6}), *(\d{1,6}), *3\),? *\}\s*"
)
REQUEST, ANSWER = ".request.json", ".answer.json"


class ScanDropError(CodecError):
    """A file that is not what it should be."""


@dataclass(frozen=True, slots=True)
class Request:
    """What the host asks; `view` for a capture only."""

    number: int
    ask: Ask
    view: str = ""

    @property
    def stem(self) -> str:
        """What the names of all its files begin with."""
        return f"{self.number:08d}"


@dataclass(frozen=True, slots=True)
class Failed:
    """It was not done."""

    error: Failure
    reason: str


@dataclass(frozen=True, slots=True)
class IdentityTold:
    """Who the scanner is."""

    vendor: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True, slots=True)
class StateTold:
    """Whether the projector is lit."""

    projecting: bool


@dataclass(frozen=True, slots=True)
class FrameTold:
    """A frame that lies in `file`: `size` bytes, rows and columns in `shape`. `age_s`: since its exposure ended."""

    frame_id: int
    view: str
    unit: str
    age_s: float
    file: str
    size: int
    shape: tuple[int, int]


Answer = Failed | IdentityTold | StateTold | FrameTold


def encode_request(request: Request) -> bytes:
    """Content of the request's file."""
    data: dict[str, Any] = {"request": request.number, "ask": request.ask}
    return json.dumps(data | ({"view": request.view} if request.view else {})).encode()


def decode_request(data: bytes) -> Request:
    """Raises ScanDropError."""
    fields = _Fields(data)
    return Request(fields.whole("request"), fields.one_of("ask", get_args(Ask)), fields.text("view", ""))


def encode_answer(number: int, answer: Answer) -> bytes:
    """Content of the file that answers request `number`."""
    data: dict[str, Any] = {"request": number, "ok": not isinstance(answer, Failed)}
    match answer:
        case Failed(error, reason):
            data |= {"error": error, "reason": reason}
        case IdentityTold(vendor, model, serial, firmware):
            data |= {"vendor": vendor, "model": model, "serial": serial, "firmware": firmware}
        case StateTold(projecting):
            data |= {"projecting": projecting}
        case FrameTold(frame_id, view, unit, age_s, file, size, shape):
            data |= {"frame_id": frame_id, "view": view, "unit": unit, "age_s": age_s}
            data |= {"file": file, "bytes": size, "shape": list(shape)}
    return json.dumps(data).encode()


def decode_answer(data: bytes, request: Request) -> Answer:
    """The answer to `request`. Raises ScanDropError, also for the answer to another one."""
    fields = _Fields(data)
    if (number := fields.whole("request")) != request.number:
        raise ScanDropError("request", f"{number} is answered, {request.number} was asked")
    if not fields.true("ok"):
        return Failed(fields.one_of("error", get_args(Failure)), fields.text("reason"))
    match request.ask:
        case "identify":
            names = ("vendor", "model", "serial", "firmware")
            return IdentityTold(*(fields.text(name) for name in names))
        case "state" | "halt":
            return StateTold(fields.true("projecting"))
        case "capture":
            file = fields.text("file")
            if file not in (f"{request.stem}.npz", f"{request.stem}.npy"):
                raise ScanDropError("file", f"{file!r} is neither {request.stem}.npz nor {request.stem}.npy")
            return FrameTold(
                frame_id=fields.whole("frame_id"),
                view=fields.text("view"),
                unit=fields.text("unit"),
                age_s=fields.seconds("age_s"),
                file=file,
                size=fields.whole("bytes", LARGEST_FILE),
                shape=fields.shape("shape"),
            )


def encode_cloud(points: NDArray[np.float32]) -> bytes:
    """An ``.npz`` file, not packed."""
    file = io.BytesIO()
    np.savez(file, points=points)
    return file.getvalue()


def decode_cloud(data: bytes, told: FrameTold) -> NDArray[np.float32]:
    """(H, W, 3) float32 in the unit that was told; what is not finite is NaN. Raises ScanDropError, as where it was cut
    off or is not of the size that was told."""
    if len(data) != told.size:
        raise ScanDropError(told.file, f"half a frame: {len(data)} of {told.size} bytes")
    array = _npy(_member(data, told.file) if told.file.endswith(".npz") else data, told.file)
    if array.shape != (*told.shape, 3):
        raise ScanDropError(told.file, f"half a frame: shape {array.shape}, told was {(*told.shape, 3)}")
    points: NDArray[np.float32] = array.astype(np.float32)
    points[~np.isfinite(points).all(axis=2)] = np.nan
    return points


def _member(data: bytes, place: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            entry = file.getinfo("points.npy")
            if entry.file_size > LARGEST_FILE:
                raise ScanDropError(place, f"{entry.file_size} bytes unpacked (limit {LARGEST_FILE})")
            return file.read(entry)
    except KeyError:
        raise ScanDropError(place, "has no array called points") from None
    except ScanDropError:
        raise
    except Exception as error:  # zipfile says broken in many ways
        raise ScanDropError(place, f"is no readable NPZ file ({error})") from None


def _npy(data: bytes, place: str) -> NDArray[Any]:
    """The array; its header is believed only where it agrees with the bytes that follow.

    NPY format: magic, version, little-endian header length of two bytes (version 1) or four, and a dictionary as text.
    """
    width = 2 if data[6:7] == b"\x01" else 4
    start = 8 + width + int.from_bytes(data[8 : 8 + width], "little")
    if not data.startswith(b"\x93NUMPY") or start > len(data):
        raise ScanDropError(place, "is no readable NPY file")
    header = data[8 + width : start]
    found = _NPY.fullmatch(header)
    if found is None:
        text = header[:100].decode("latin-1").strip()
        raise ScanDropError(place, f"{text}: rows of columns of three float32 or float64 are needed")
    dtype, shape = np.dtype(found[1].decode()), (int(found[2]), int(found[3]), 3)
    if math.prod(shape) * dtype.itemsize != len(data) - start:
        raise ScanDropError(place, f"half a frame: {len(data) - start} bytes for an array {shape} of {dtype}")
    return np.frombuffer(data, dtype, offset=start).reshape(shape)


class _Fields:
    """A JSON object, field by field; each of its own type and within bounds."""

    def __init__(self, data: bytes) -> None:
        if len(data) > LARGEST_ANSWER:
            raise ScanDropError("file", f"{len(data)} bytes (limit {LARGEST_ANSWER})")
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise ScanDropError("file", f"is no JSON ({error})") from None
        if not isinstance(value, dict):
            raise ScanDropError("file", "is no JSON object")
        self._fields = value

    def text(self, name: str, default: str | None = None) -> str:
        value = self._fields.get(name, default)
        if not isinstance(value, str) or len(value) > 1000:
            raise _wrong(name, value, "a text")
        return value

    def one_of(self, name: str, known: tuple[Any, ...]) -> Any:
        value = self._fields.get(name)
        if value not in known:
            raise _wrong(name, value, f"one of {', '.join(known)}")
        return value

    def whole(self, name: str, most: int = 2**53) -> int:
        value = self._fields.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
            raise _wrong(name, value, f"a whole number up to {most}")
        return value

    def seconds(self, name: str) -> float:
        value = self._fields.get(name)
        if not isinstance(value, int | float) or isinstance(value, bool) or not 0.0 <= value < math.inf:
            raise _wrong(name, value, "seconds, not negative")
        return float(value)

    def true(self, name: str) -> bool:
        value = self._fields.get(name)
        if not isinstance(value, bool):
            raise _wrong(name, value, "true or false")
        return value

    def shape(self, name: str) -> tuple[int, int]:
        value = self._fields.get(name)
        match value:
            case [int(rows), int(columns)] if 0 < rows <= 65536 and 0 < columns <= 65536:
                return rows, columns
        raise _wrong(name, value, "[rows, columns]")


def _wrong(name: str, value: object, wanted: str) -> ScanDropError:
    return ScanDropError(name, f"{str(value)[:60]!r} is not {wanted}")
