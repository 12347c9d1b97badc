"""What controller and guard process say to each other over their socket: framed messages, the smallest ones binary.

A message is its length (2 bytes, little endian, of what follows), its kind (1 byte), its body. CAN frames are binary,
with the epoch in which their sender was allowed to move something; all else is a JSON object of plain values.
"""

from __future__ import annotations

import json
import struct
from enum import IntEnum
from typing import Any

from hal.codec.errors import CodecError
from hal.codec.lawicel import CanFrame

LONGEST = 4096
"""Bytes of a message; a longer one is none."""


class Kind(IntEnum):
    """What a message is."""

    FRAME = 1
    """A CAN frame, either way."""
    BEAT = 2
    """To the guard: the controller lives. Its body is empty."""
    CALL = 3
    """To the guard: do something; `tag` comes back with the answer."""
    ANSWER = 4
    """What became of a call."""
    STATE = 5
    """From the guard, in its own cycle and with each change: what it knows and how its wires are."""


class GuardMessageError(CodecError):
    """Bytes that are no message."""


_FRAME = struct.Struct("<IIB")
_EXTENDED, _REMOTE = 0x01, 0x02


def encode(kind: Kind, body: bytes = b"") -> bytes:
    """One message."""
    return struct.pack("<HB", 1 + len(body), kind) + body


def encode_frame(frame: CanFrame, epoch: int) -> bytes:
    """The message that carries `frame`."""
    flags = _EXTENDED * frame.extended | _REMOTE * frame.remote
    return encode(Kind.FRAME, _FRAME.pack(epoch & 0xFFFFFFFF, frame.can_id, flags) + frame.data)


def decode_frame(body: bytes) -> tuple[CanFrame, int]:
    """Frame and epoch. Raises GuardMessageError."""
    if not _FRAME.size <= len(body) <= _FRAME.size + 8:
        raise GuardMessageError("frame", f"{len(body)} bytes, expected {_FRAME.size} to {_FRAME.size + 8}")
    epoch, can_id, flags = _FRAME.unpack_from(body)
    return CanFrame(can_id, body[_FRAME.size :], bool(flags & _EXTENDED), bool(flags & _REMOTE)), epoch


def encode_object(kind: Kind, values: dict[str, Any]) -> bytes:
    """The message that carries plain values; not-a-number and infinities are kept."""
    return encode(kind, json.dumps(values).encode())


def decode_object(body: bytes) -> dict[str, Any]:
    """Raises GuardMessageError."""
    try:
        values = json.loads(body)
    except ValueError as error:
        raise GuardMessageError("object", str(error)) from None
    if not isinstance(values, dict):
        raise GuardMessageError("object", f"{type(values).__name__}, expected an object")
    return values


def split(buffer: bytes) -> tuple[list[tuple[Kind, bytes]], bytes]:
    """Whole messages in `buffer`, and the rest. Raises GuardMessageError: the other side speaks something else."""
    messages, at = [], 0
    while len(buffer) - at >= 3:
        length, kind = struct.unpack_from("<HB", buffer, at)
        if not 1 <= length <= LONGEST:
            raise GuardMessageError("length", f"{length}, limit {LONGEST}")
        if kind not in Kind.__members__.values():
            raise GuardMessageError("kind", f"{kind} is nothing known")
        if len(buffer) - at < 2 + length:
            break
        messages.append((Kind(kind), buffer[at + 3 : at + 2 + length]))
        at += 2 + length
    return messages, buffer[at:]
