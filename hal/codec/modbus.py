"""Modbus requests and replies as frames on TCP and RTU, the server's side. Pure.

After "MODBUS Application Protocol Specification V1.1b3" (functions 01, 03, 04, 05, 06, 16 and exceptions), "MODBUS
Messaging on TCP/IP Implementation Guide V1.0b" (MBAP header) and "MODBUS over Serial Line V1.02" (CRC, 6.2.2).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

Framing = Literal["tcp", "rtu"]

READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE_MANY = 3, 4, 6, 16
READ_COILS, WRITE_COIL = 1, 5
MAX_READ, MAX_WRITE, MAX_COILS = 125, 123, 2000
_READS = {READ_COILS: MAX_COILS, READ_HOLDING: MAX_READ, READ_INPUT: MAX_READ}
_ON = 0xFF00
_EXCEPTION = 0x80
_MBAP = struct.Struct(">HHHB")


class FrameError(ValueError):
    """Bytes that are no Modbus frame; what was received before them is of no use either."""


class ExceptionCode(IntEnum):
    """Why a server does not do what was asked (specification, section 7)."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_ADDRESS = 2
    ILLEGAL_VALUE = 3
    DEVICE_FAILURE = 4
    ACKNOWLEDGE = 5
    BUSY = 6
    GATEWAY_PATH = 10
    GATEWAY_TARGET = 11


@dataclass(frozen=True, slots=True)
class Request:
    """One request for registers or coils. `words` is what is to be written, empty for a read, 1 or 0 for a coil;
    `transaction` is 0 on RTU."""

    unit: int
    function: int
    address: int
    count: int
    words: tuple[int, ...] = ()
    transaction: int = 0


@dataclass(frozen=True, slots=True)
class Unsupported:
    """A request whole and well framed that asks for a function nobody serves, or for an impossible count."""

    unit: int
    function: int
    code: ExceptionCode
    transaction: int = 0


def crc16(data: bytes) -> int:
    """CRC of a serial frame: polynomial 0xA001 reflected, from 0xFFFF; sent low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc


def take_request(data: bytes, framing: Framing) -> tuple[Request | Unsupported | None, int]:
    """(request, bytes used) from the front of `data`; (None, 0) while it is not whole. Raises FrameError."""
    return _take_tcp(data) if framing == "tcp" else _take_rtu(data)


def reply(request: Request, words: tuple[int, ...], framing: Framing) -> bytes:
    """Frame that answers `request`: the registers or coils (1 or 0) read, or the echo of a write."""
    if request.function in (READ_HOLDING, READ_INPUT):
        body = struct.pack(f">BB{len(words)}H", request.function, 2 * len(words), *words)
    elif request.function == READ_COILS:
        size = -(-len(words) // 8)
        packed = sum(1 << place for place, on in enumerate(words) if on)
        body = bytes((READ_COILS, size)) + packed.to_bytes(size, "little")
    elif request.function == WRITE_COIL:
        body = struct.pack(">BHH", WRITE_COIL, request.address, _ON if request.words[0] else 0)
    elif request.function == WRITE_ONE:
        body = struct.pack(">BHH", WRITE_ONE, request.address, *request.words)
    else:
        body = struct.pack(">BHH", WRITE_MANY, request.address, request.count)
    return _frame(request, body, framing)


def refusal(request: Request | Unsupported, code: int, framing: Framing) -> bytes:
    """Frame that answers `request` with an exception."""
    return _frame(request, bytes((request.function | _EXCEPTION, code)), framing)


def _frame(request: Request | Unsupported, body: bytes, framing: Framing) -> bytes:
    if framing == "tcp":
        return _MBAP.pack(request.transaction, 0, len(body) + 1, request.unit) + body
    frame = bytes((request.unit,)) + body
    return frame + struct.pack("<H", crc16(frame))


def _take_tcp(data: bytes) -> tuple[Request | Unsupported | None, int]:
    if len(data) < _MBAP.size:
        return None, 0
    transaction, protocol, length, unit = _MBAP.unpack_from(data)
    if protocol != 0 or not 2 <= length <= 254:
        raise FrameError(f"MBAP header {data[: _MBAP.size].hex(' ')}: protocol {protocol}, length {length}")
    end = 6 + length
    if len(data) < end:
        return None, 0
    return _parsed(unit, data[7:end], transaction), end


def _take_rtu(data: bytes) -> tuple[Request | Unsupported | None, int]:
    if len(data) < 2 or (data[1] == WRITE_MANY and len(data) < 7):
        return None, 0
    end = 9 + data[6] if data[1] == WRITE_MANY else 8
    if len(data) < end:
        return None, 0
    frame, crc = data[: end - 2], int.from_bytes(data[end - 2 : end], "little")
    if crc != crc16(frame):
        raise FrameError(f"frame {data[:end].hex(' ')}: CRC {crc:04x}, computed {crc16(frame):04x}")
    return _parsed(data[0], frame[1:], 0), end


def _parsed(unit: int, body: bytes, transaction: int) -> Request | Unsupported:
    function = body[0]
    if function not in (*_READS, WRITE_COIL, WRITE_ONE, WRITE_MANY):
        return Unsupported(unit, function, ExceptionCode.ILLEGAL_FUNCTION, transaction)
    bad = Unsupported(unit, function, ExceptionCode.ILLEGAL_VALUE, transaction)
    if len(body) < 5:
        return bad
    address, second = struct.unpack_from(">HH", body, 1)
    if function == WRITE_ONE:
        return Request(unit, function, address, 1, (second,), transaction)
    if function == WRITE_COIL:
        return Request(unit, function, address, 1, (int(second == _ON),), transaction) if second in (0, _ON) else bad
    if function != WRITE_MANY:
        return Request(unit, function, address, second, (), transaction) if 1 <= second <= _READS[function] else bad
    if not 1 <= second <= MAX_WRITE or len(body) != 6 + 2 * second or body[5] != 2 * second:
        return bad
    return Request(unit, function, address, second, struct.unpack_from(f">{second}H", body, 6), transaction)
