"""Open Protocol: curves, MID 0900 of revision 1, text and then binary samples behind a NUL.

Text: result (10), time stamp (19), fields (3 and each), trace type (2), transducer (2), unit (3), parameters (3 and
each), resolutions (3 and each), number of samples (5). A field is PID (5), length (3), type (2), unit (3), step (4),
value; a resolution is first and last index (5, 5), length (3), type (2), unit (3), value. A sample is a signed 16-bit
number; parameter 02213 divides it, 02214 multiplies it. The specification has them big-endian; some controllers send
little-endian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hal.codec.open_protocol import Message, OpenProtocolError
from hal.codec.open_protocol_messages import TRACE

ANGLE, TORQUE = 1, 2
NEWTON_METRE, MILLINEWTON_METRE, DEGREE = 1, 90, 50
DIVISOR, FACTOR = "02213", "02214"
_SECONDS = {200: 1.0, 201: 60.0, 202: 1e-3, 203: 3600.0}
Order = Literal["big", "little"]
MOST = 4500
"""Samples that surely fit one message."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One quantity over time: `values` (n,) in N m (torque) or deg (angle), `time_s` (n,) from the first sample."""

    result: int
    stamp: str
    kind: int
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]


class _Text:
    """Takes one piece after the other off the text."""

    def __init__(self, raw: bytes) -> None:
        self._raw = raw
        self._at = 0

    def take(self, width: int, what: str) -> str:
        piece = self._raw[self._at : self._at + width]
        if len(piece) < width:
            raise OpenProtocolError(f"MID 0900 {what}", f"{len(piece)} of {width} bytes")
        self._at += width
        return piece.decode("latin-1")

    def number(self, width: int, what: str) -> int:
        text = self.take(width, what)
        if not text.strip().isdigit():
            raise OpenProtocolError(f"MID 0900 {what}", f"{text!r} is no number")
        return int(text)

    def fields(self, what: str) -> dict[str, str]:
        """Values by PID."""
        found = {}
        for _ in range(self.number(3, f"number of {what}")):
            pid = self.take(5, f"{what} PID")
            length = self.number(3, f"{what} {pid} length")
            self.take(9, f"{what} {pid} type, unit and step")
            found[pid] = self.take(length, f"{what} {pid}")
        return found


def read_curve(message: Message, order: Order = "big") -> Curve:
    """MID 0900 of revision 1. Raises OpenProtocolError."""
    text, nul, binary = message.data.partition(b"\0")
    if not nul:
        raise OpenProtocolError("MID 0900", "no NUL before the samples")
    piece = _Text(text)
    result, stamp = piece.number(10, "result"), piece.take(19, "time stamp")
    piece.fields("fields")
    kind = piece.number(2, "trace type")
    piece.take(2, "transducer")
    unit = piece.number(3, "unit")
    scale = _scale(kind, unit) * _coefficient(piece.fields("parameters"))
    steps = [_resolution(piece) for _ in range(piece.number(3, "number of resolutions"))]
    count = piece.number(5, "number of samples")
    if len(binary) != 2 * count:
        raise OpenProtocolError("MID 0900 samples", f"{len(binary)} bytes for {count} samples")
    step_s = np.concatenate([np.full(n, s) for n, s in steps] or [np.empty(0)])
    if len(step_s) < count:
        raise OpenProtocolError("MID 0900 resolutions", f"they cover {len(step_s)} of {count} samples")
    time_s = np.concatenate([[0.0], np.cumsum(step_s[1:count])])[:count]
    values = np.frombuffer(binary, ">i2" if order == "big" else "<i2").astype(np.float64) * scale
    return Curve(result, stamp, kind, time_s, values)


def _scale(kind: int, unit: int) -> float:
    if (kind, unit) in ((TORQUE, NEWTON_METRE), (ANGLE, DEGREE)):
        return 1.0
    if (kind, unit) == (TORQUE, MILLINEWTON_METRE):
        return 1e-3
    raise OpenProtocolError("MID 0900 unit", f"{unit:03d} for trace type {kind}: not newton metre, not degrees")


def _coefficient(parameters: dict[str, str]) -> float:
    for pid in (DIVISOR, FACTOR):
        if pid in parameters:
            try:
                value = float(parameters[pid])
            except ValueError:
                value = math.nan
            if not (math.isfinite(value) and value > 0.0):
                raise OpenProtocolError(f"MID 0900 parameter {pid}", f"{parameters[pid]!r} is no coefficient")
            return 1.0 / value if pid == DIVISOR else value
    return 1.0


def _resolution(piece: _Text) -> tuple[int, float]:
    """(number of samples, seconds from one to the next)."""
    first, last = piece.number(5, "first index"), piece.number(5, "last index")
    length = piece.number(3, "resolution length")
    piece.take(2, "resolution type")
    unit = piece.number(3, "resolution unit")
    text = piece.take(length, "resolution")
    try:
        step = float(text)
    except ValueError:
        step = math.nan
    if unit not in _SECONDS or not (math.isfinite(step) and step > 0.0) or last < first:
        raise OpenProtocolError("MID 0900 resolution", f"{first} to {last}, {text!r} of unit {unit:03d}")
    return last - first + 1, step * _SECONDS[unit]


def curve(value: Curve, steps: tuple[tuple[int, float], ...], order: Order = "big") -> Message:
    """MID 0900 of revision 1; `steps` are (number of samples, seconds to the next) in order."""
    peak = float(np.max(np.abs(value.values), initial=0.0))
    factor = f"{max(peak, 1e-6) / 32000.0:.6e}"
    samples = np.round(value.values / float(factor)).astype(">i2" if order == "big" else "<i2")
    unit = NEWTON_METRE if value.kind == TORQUE else DEGREE
    text = f"{value.result:010d}{value.stamp:19}000{value.kind:02d}01{unit:03d}"
    text += f"001{FACTOR}{len(factor):03d}030000000{factor}{len(steps):03d}"
    first = 0
    for count, step_s in steps:
        seconds = f"{step_s:.6e}"
        text += f"{first:05d}{first + count - 1:05d}{len(seconds):03d}03200{seconds}"
        first += count
    text += f"{len(samples):05d}"
    return Message(TRACE, text.encode("latin-1") + b"\0" + samples.tobytes())


def wanted(kinds: tuple[int, ...]) -> bytes:
    """Extra data of MID 0008 for MID 0900: coming results (0), no index and no time, the kinds of curve."""
    return b"0" + b"0" * 29 + b"%02d" % len(kinds) + b"".join(b"%03d" % kind for kind in kinds)


def read_wanted(extra: bytes) -> tuple[int, ...]:
    """Kinds of curve in the extra data of MID 0008 for MID 0900."""
    piece = _Text(extra)
    piece.take(30, "subscription")
    return tuple(piece.number(3, "kind") for _ in range(piece.number(2, "number of kinds")))


def of_result(number: int, kind: int) -> bytes:
    """Extra data of MID 0006 for MID 0900: the curve `kind` of tightening `number`."""
    return b"%010d%03d" % (number, kind)


def read_of_result(extra: bytes) -> tuple[int, int]:
    """(tightening, kind of curve) in the extra data of MID 0006 for MID 0900."""
    piece = _Text(extra)
    return piece.number(10, "tightening"), piece.number(3, "kind")
