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

A cloud is organised, (H, W, 3) floats, not a number where nothing was measured: ``.npz`` with the one array ``points``,
``.npy``, ``.ply`` (vertices row by row) or ``.pcd``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hal.codec.cloud_arrays import LARGEST_FILE, decode_npy, decode_npz, encode_npy, encode_npz
from hal.codec.cloud_tables import decode_pcd, decode_ply, encode_pcd, encode_ply
from hal.codec.errors import CodecError

Ask = Literal["identify", "state", "capture", "halt"]
Failure = Literal["refused", "fault", "interrupted"]
CloudKind = Literal["npz", "npy", "ply", "pcd"]

LARGEST_ANSWER = 1 << 16
REQUEST, ANSWER = ".request.json", ".answer.json"
_READ: Mapping[str, Callable[[bytes, str, tuple[int, int]], NDArray[Any]]] = MappingProxyType(
    {"npz": decode_npz, "npy": decode_npy, "ply": decode_ply, "pcd": decode_pcd}
)
_WRITE: Mapping[str, Callable[[NDArray[np.float32]], bytes]] = MappingProxyType(
    {"npz": encode_npz, "npy": encode_npy, "ply": encode_ply, "pcd": encode_pcd}
)


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
            if file not in [f"{request.stem}.{kind}" for kind in _READ]:
                raise ScanDropError(
                    "file", f"{file!r} is not {request.stem} with one of the endings {', '.join(_READ)}"
                )
            return FrameTold(
                frame_id=fields.whole("frame_id"),
                view=fields.text("view"),
                unit=fields.text("unit"),
                age_s=fields.seconds("age_s"),
                file=file,
                size=fields.whole("bytes", LARGEST_FILE),
                shape=fields.shape("shape"),
            )


def encode_cloud(points: NDArray[np.float32], kind: CloudKind = "npz") -> bytes:
    """A file of this kind, not packed."""
    return _WRITE[kind](points)


def decode_cloud(data: bytes, told: FrameTold) -> NDArray[np.float32]:
    """(H, W, 3) float32 in the unit that was told; what is not finite is NaN. Raises ScanDropError, as where it was cut
    off or is not of the size that was told."""
    if len(data) != told.size:
        raise ScanDropError(told.file, f"half a frame: {len(data)} of {told.size} bytes")
    try:
        array = _READ[told.file[-3:]](data, told.file, told.shape)
    except CodecError as error:
        raise ScanDropError(error.place, error.reason) from None
    points: NDArray[np.float32] = array.astype(np.float32)
    points[~np.isfinite(points).all(axis=2)] = np.nan
    return points


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
