"""CAN frames as LAWICEL ASCII lines (slcan): what serial and TCP adapters speak. Each line ends with CR or BEL.

``tIIILDD..`` standard and ``TIIIIIIIILDD..`` extended data frames, ``r``/``R`` remote ones: identifier in hex, one
digit length, data in hex. Source: CAN232/CANUSB manuals, Lawicel AB.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

CR, BEL = b"\r", b"\a"
MAX_LINE = 64
"""Longer without an end is no line."""

_LINE = re.compile(
    rb"(?:(?P<standard>[tr])(?P<id3>[0-9A-Fa-f]{3})|(?P<extended>[TR])(?P<id8>[0-9A-Fa-f]{8}))"
    rb"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)


class LawicelError(ValueError):
    """A line that is no frame; the text names what is wrong with it."""


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One classic CAN frame; `data` holds 0 to 8 bytes and is empty in a remote frame."""

    can_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False


def encode(frame: CanFrame) -> bytes:
    """The line of `frame`, CR included. Raises LawicelError."""
    limit = 0x1FFFFFFF if frame.extended else 0x7FF
    if not 0 <= frame.can_id <= limit:
        raise LawicelError(f"identifier {frame.can_id:#x} is not within 0 to {limit:#x}")
    if len(frame.data) > 8:
        raise LawicelError(f"{len(frame.data)} bytes of data, limit 8")
    letter = "r" if frame.remote else "t"
    head = f"{letter.upper()}{frame.can_id:08X}" if frame.extended else f"{letter}{frame.can_id:03X}"
    return f"{head}{len(frame.data):d}{frame.data.hex().upper()}".encode() + CR


def decode(line: bytes) -> CanFrame:
    """The frame of one line without its end. Raises LawicelError where a byte is missing, too many or no hex."""
    found = _LINE.fullmatch(line)
    if found is None:
        raise LawicelError(f"{line!r} is no frame")
    remote = line[:1] in b"rR"
    data = bytes.fromhex(found["data"].decode())
    if len(data) != (0 if remote else int(found["length"])):
        raise LawicelError(f"{line!r} says {found['length'].decode()} bytes and carries {len(data)}")
    extended = found["extended"] is not None
    return CanFrame(int(found["id8"] if extended else found["id3"], 16), data, extended, remote)


def split(buffer: bytes) -> tuple[list[bytes], bytes]:
    """Whole lines in `buffer` without their ends, and the rest, which is dropped where it can be no line."""
    *lines, rest = buffer.replace(BEL, CR).split(CR)
    return lines, rest if len(rest) <= MAX_LINE else b""
