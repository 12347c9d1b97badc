"""Line protocol of a streaming force amplifier: ASCII lines, readable in any terminal, each with its checksum.

A line is ``payload*CCCC`` and a line feed; CCCC is CRC-16/IBM-3740 of the payload (polynomial 0x1021, start 0xFFFF, not
reflected; check value of ``123456789``: 29B1), four upper-case hexadecimal digits. Payloads::

    F 00A3 +980.6650              sample number 0x00A3 (modulo 65536, from 0 at `start`), newton, compression positive
    F 00A3 +OVR  |  -OVR  |  NAN  beyond the range on either side; no signal (bridge or cable of the gauge open)
    ? 17 start                    request number 17: identify, state, start, stop
    I 17 vendor|model|serial|firmware|1000|2000      identity, samples per second, range in newton
    S 17 streaming  |  idle       the state after the request
"""

from __future__ import annotations

import binascii
import math
import re
from dataclasses import dataclass
from typing import Literal, get_args

from hal.codec.errors import CodecError

MODULO = 0x10000
"""Sample numbers count modulo this."""
LONGEST = 200
"""Bytes of a line; what is longer is none."""

Verb = Literal["identify", "state", "start", "stop"]

_SAMPLE = re.compile(rb"F ([0-9A-F]{4}) (?:([+-]\d{1,7}\.\d{4})|([+-])OVR|NAN)")
_REQUEST = re.compile(rb"\? (\d{1,9}) ([a-z]+)")
_IDENTITY = re.compile(rb"I (\d{1,9}) ([^|*]+)\|([^|*]+)\|([^|*]+)\|([^|*]+)\|(\d{1,7}(?:\.\d+)?)\|(\d{1,7}(?:\.\d+)?)")
_STATE = re.compile(rb"S (\d{1,9}) (streaming|idle)")

_BEYOND = {b"+": math.inf, b"-": -math.inf, None: math.nan}


class ForceLineError(CodecError):
    """A line that is none."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample; infinite beyond the range, NaN without a signal."""

    sequence: int
    force_n: float


@dataclass(frozen=True, slots=True)
class Request:
    """What the host asks; `tag` comes back with the answer."""

    tag: int
    verb: Verb


@dataclass(frozen=True, slots=True)
class IdentityTold:
    """Who the amplifier is and how it samples."""

    tag: int
    vendor: str
    model: str
    serial: str
    firmware: str
    rate_hz: float
    range_n: float


@dataclass(frozen=True, slots=True)
class StateTold:
    """Whether samples are being sent."""

    tag: int
    streaming: bool


Message = Sample | Request | IdentityTold | StateTold


def checksum(payload: bytes) -> bytes:
    """Four hexadecimal digits."""
    return b"%04X" % binascii.crc_hqx(payload, 0xFFFF)


def encode(message: Message) -> bytes:
    """The line of `message` with its line feed."""
    match message:
        case Sample(sequence, force_n):
            payload = f"F {sequence % MODULO:04X} {_number(force_n)}"
        case Request(tag, verb):
            payload = f"? {tag} {verb}"
        case IdentityTold(tag, vendor, model, serial, firmware, rate_hz, range_n):
            payload = f"I {tag} {vendor}|{model}|{serial}|{firmware}|{rate_hz:g}|{range_n:g}"
        case StateTold(tag, streaming):
            payload = f"S {tag} {'streaming' if streaming else 'idle'}"
    data = payload.encode("ascii")
    return data + b"*" + checksum(data) + b"\n"


def _number(force_n: float) -> str:
    if math.isnan(force_n):
        return "NAN"
    return f"{force_n:+.4f}" if math.isfinite(force_n) else f"{'+' if force_n > 0 else '-'}OVR"


def decode(line: bytes) -> Message:
    """The message of one line without its line feed. Raises ForceLineError."""
    payload, star, check = line.removesuffix(b"\r").rpartition(b"*")
    if not star:
        raise ForceLineError("line", f"{len(line)} bytes without a checksum")
    if checksum(payload) != check:
        raise ForceLineError("checksum", f"{check!r} came, {checksum(payload)!r} computed")
    if found := _SAMPLE.fullmatch(payload):
        number, value, side = found.groups()
        if value is None:
            return Sample(int(number, 16), _BEYOND[side])
        return Sample(int(number, 16), float(value))
    if found := _STATE.fullmatch(payload):
        return StateTold(int(found[1]), found[2] == b"streaming")
    if found := _IDENTITY.fullmatch(payload):
        vendor, model, serial, firmware = (part.decode("ascii", "replace") for part in found.group(2, 3, 4, 5))
        return IdentityTold(int(found[1]), vendor, model, serial, firmware, float(found[6]), float(found[7]))
    if found := _REQUEST.fullmatch(payload):
        for verb in get_args(Verb):
            if verb.encode() == found[2]:
                return Request(int(found[1]), verb)
    raise ForceLineError("payload", f"{payload[:40]!r} is nothing known")


def split(buffer: bytes) -> tuple[list[bytes], bytes]:
    """Whole lines of `buffer`, and the rest, of which no more is kept than the longest line."""
    *lines, rest = buffer.split(b"\n")
    return lines, rest[-LONGEST:]
