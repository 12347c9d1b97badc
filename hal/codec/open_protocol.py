"""Open Protocol on TCP: framing, header and fields. Source: Atlas Copco 9836 4415 01, release 2.8 and later, chapter 2.

A message is a header of 20 ASCII bytes, data, and a closing NUL that the length does not count::

    0-3 length  4-7 MID  8-10 revision  11 no-ack  12-13 station  14-15 spindle  16-17 sequence  18 parts  19 part

Unused header fields are blank; a blank revision is revision 1. A message with a binary part (MID 0900) has its NUL
between text and binary, inside the length, and none is owed at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from hal.codec.errors import CodecError

HEADER = 20
LONGEST = 9999
BINARY_MIDS = frozenset({900})


class OpenProtocolError(CodecError):
    """Bytes that are no message, or a message that cannot be told."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message; `data` is everything after the header but the closing NUL."""

    mid: int
    data: bytes = b""
    revision: int = 1
    no_ack: bool = False
    station: int = 0
    spindle: int = 0
    sequence: int = 0
    parts: int = 0
    part: int = 0

    @property
    def text(self) -> str:
        """The data as text, for places that carry no binary."""
        return self.data.decode("latin-1")

    def __str__(self) -> str:
        return f"MID {self.mid:04d}"


def encode(message: Message) -> bytes:
    """The bytes of `message`, its closing NUL included. Raises OpenProtocolError where a number does not fit."""
    length = HEADER + len(message.data)
    numbers = (message.station, 2), (message.spindle, 2), (message.sequence, 2), (message.parts, 1), (message.part, 1)
    header = _digits(length, 4, f"{message} length") + _digits(message.mid, 4, "MID")
    header += _digits(message.revision, 3, f"{message} revision") + ("1" if message.no_ack else " ")
    header += "".join(_digits(value, width, f"{message} header") if value else " " * width for value, width in numbers)
    return header.encode("ascii") + message.data + (b"" if message.mid in BINARY_MIDS else b"\0")


def _digits(value: int, width: int, place: str) -> str:
    if not 0 <= value < 10**width:
        raise OpenProtocolError(place, f"{value} does not fit {width} digits")
    return f"{value:0{width}d}"


class Framer:
    """Cuts a stream of bytes into messages, whatever pieces it comes in. One per connection."""

    def __init__(self) -> None:
        self._left = bytearray()

    def feed(self, received: bytes) -> list[Message]:
        """The messages that `received` completes. Raises OpenProtocolError: the stream cannot be trusted any more."""
        self._left += received
        messages = []
        while (message := self._next()) is not None:
            messages.append(message)
        return messages

    def _next(self) -> Message | None:
        while self._left[:1] == b"\0":  # some controllers close a binary message with a NUL of its own
            del self._left[0]
        if len(self._left) < HEADER:
            return None
        header = bytes(self._left[:HEADER])
        length = _number(header[:4], "length")
        mid = _number(header[4:8], "MID")
        if length < HEADER:
            raise OpenProtocolError("length", f"{length} is shorter than a header")
        closing = mid not in BINARY_MIDS
        if len(self._left) < length + closing:
            return None
        if closing and self._left[length]:
            raise OpenProtocolError(f"MID {mid:04d}", f"no NUL after {length} bytes")
        data = bytes(self._left[HEADER:length])
        del self._left[: length + closing]
        return _message(header, mid, data)


def _message(header: bytes, mid: int, data: bytes) -> Message:
    return Message(
        mid,
        data,
        revision=max(_number(header[8:11], "revision", blank=1), 1),
        no_ack=header[11:12] == b"1",
        station=_number(header[12:14], "station", blank=0),
        spindle=_number(header[14:16], "spindle", blank=0),
        sequence=_number(header[16:18], "sequence", blank=0),
        parts=_number(header[18:19], "parts", blank=0),
        part=_number(header[19:20], "part", blank=0),
    )


def _number(raw: bytes, place: str, *, blank: int | None = None) -> int:
    text = raw.strip()
    if not text and blank is not None:
        return blank
    if not text.isdigit():
        raise OpenProtocolError(place, f"{raw!r} is no number")
    return int(text)


Kind = Literal["int", "text", "nm", "flag", "skip"]
"""nm: newton metre times 100. skip: zeros that nobody reads."""
Layout = tuple[tuple[str, int, Kind], ...]
"""(name, width, kind) of each field in order."""


def read_fields(message: Message, layout: Layout, *, numbered: bool = True) -> dict[str, Any]:
    """The fields of `message` by name; `numbered` ones stand behind their two-digit number. What follows is ignored.

    Raises OpenProtocolError where one is missing or is not what it should be.
    """
    values: dict[str, Any] = {}
    at = 0
    for count, (name, width, kind) in enumerate(layout, start=1):
        place = f"{message} {name or 'field'} ({count:02d})"
        if numbered:
            if message.data[at : at + 2] != b"%02d" % count:
                raise OpenProtocolError(place, f"its number is missing, there is {message.data[at : at + 2]!r}")
            at += 2
        raw = message.data[at : at + width]
        if len(raw) < width:
            raise OpenProtocolError(place, f"{len(raw)} of {width} bytes")
        if kind != "skip":
            values[name] = _value(raw, kind, place)
        at += width
    return values


def _value(raw: bytes, kind: Kind, place: str) -> Any:
    if kind == "text":
        return raw.decode("latin-1").rstrip()
    number = _number(raw, place)
    if kind == "nm":
        return number / 100.0
    return number == 1 if kind == "flag" else number


def write_fields(values: Mapping[str, Any], layout: Layout, place: str, *, numbered: bool = True) -> bytes:
    """The inverse of `read_fields`. Numbers are rounded to what their field can tell."""
    parts = []
    for count, (name, width, kind) in enumerate(layout, start=1):
        parts.append(f"{count:02d}" if numbered else "")
        if kind == "text":
            text = str(values[name])
            if len(text) > width:
                raise OpenProtocolError(f"{place} {name}", f"{text!r} is longer than {width} characters")
            parts.append(text.ljust(width))
        else:
            number = 0 if kind == "skip" else round(values[name] * (100.0 if kind == "nm" else 1))
            parts.append(_digits(number, width, f"{place} {name}"))
    return "".join(parts).encode("latin-1")
