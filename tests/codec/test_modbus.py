"""Modbus frames against the examples printed in the specifications."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.codec.modbus import (
    ExceptionCode,
    FrameError,
    Framing,
    Request,
    Unsupported,
    crc16,
    refusal,
    reply,
    take_request,
)

READ_HOLDING = bytes.fromhex("03 006B 0003")
"""Application protocol V1.1b3, 6.3: registers 108 to 110; the answer is 022B 0000 0064."""
READ_INPUT = bytes.fromhex("04 0008 0001")
"""6.4: input register 9; the answer is 000A."""
WRITE_ONE = bytes.fromhex("06 0001 0003")
"""6.6: register 2 to 0003; echoed."""
WRITE_MANY = bytes.fromhex("10 0001 0002 04 000A 0102")
"""6.12: registers 2 and 3."""
READ_COILS = bytes.fromhex("01 0013 0013")
"""6.1: coils 20 to 38; the answer is CD 6B 05."""
COILS = tuple(int(bit) for byte in (0xCD, 0x6B, 0x05) for bit in f"{byte:08b}"[::-1])[:19]
WRITE_COIL = bytes.fromhex("05 00AC FF00")
"""6.5: coil 173 on; echoed."""


def on_tcp(body: bytes, transaction: int = 0x1501, unit: int = 0xFF) -> bytes:
    """MBAP header by the implementation guide, 3.1.3."""
    return transaction.to_bytes(2, "big") + b"\0\0" + (len(body) + 1).to_bytes(2, "big") + bytes((unit,)) + body


def on_rtu(body: bytes, unit: int = 0x11) -> bytes:
    frame = bytes((unit,)) + body
    return frame + crc16(frame).to_bytes(2, "little")


def test_the_crc_of_the_serial_line_guide() -> None:
    assert crc16(bytes.fromhex("02 07")) == 0x1241, "serial line V1.02, appendix B: sent as 41 12"


@pytest.mark.parametrize(
    ("body", "words", "answer"),
    [
        (READ_HOLDING, (0x022B, 0x0000, 0x0064), "03 06 022B 0000 0064"),
        (READ_INPUT, (0x000A,), "04 02 000A"),
        (WRITE_ONE, (), "06 0001 0003"),
        (WRITE_MANY, (), "10 0001 0002"),
        (READ_COILS, COILS, "01 03 CD6B05"),
        (WRITE_COIL, (), "05 00AC FF00"),
    ],
)
def test_requests_and_answers_of_the_specification(body: bytes, words: tuple[int, ...], answer: str) -> None:
    request, used = take_request(on_tcp(body), "tcp")
    assert isinstance(request, Request)
    assert (request.unit, request.transaction, used) == (0xFF, 0x1501, len(on_tcp(body)))
    assert reply(request, words, "tcp") == on_tcp(bytes.fromhex(answer))
    request, used = take_request(on_rtu(body), "rtu")
    assert isinstance(request, Request)
    assert (request.unit, request.function, used) == (0x11, body[0], len(on_rtu(body)))
    assert reply(request, words, "rtu") == on_rtu(bytes.fromhex(answer))


def test_an_exception_of_the_specification() -> None:
    request, _ = take_request(on_tcp(bytes.fromhex("02 00C4 0016")), "tcp")
    assert isinstance(request, Unsupported)
    assert request.code is ExceptionCode.ILLEGAL_FUNCTION
    request, _ = take_request(on_tcp(bytes.fromhex("01 04A1 0001")), "tcp")
    assert isinstance(request, Request)
    assert refusal(request, ExceptionCode.ILLEGAL_ADDRESS, "tcp") == on_tcp(bytes.fromhex("81 02"))


@pytest.mark.parametrize(
    "body",
    [
        "03 0000 0000",
        "03 0000 007E",
        "10 0000 0002 02 0001",
        "10 0000 0000 00",
        "06 00",
        "01 0000 07D1",
        "05 0000 0001",
    ],
)
def test_impossible_counts_are_refused_as_illegal_values(body: str) -> None:
    request, _ = take_request(on_tcp(bytes.fromhex(body)), "tcp")
    assert isinstance(request, Unsupported)
    assert request.code is ExceptionCode.ILLEGAL_VALUE


@pytest.mark.parametrize(
    ("data", "framing", "match"),
    [
        (on_rtu(READ_HOLDING)[:-1] + b"\0", "rtu", "CRC"),
        (b"\x15\x01\x00\x01\x00\x06\xff" + READ_HOLDING, "tcp", "protocol 1"),
        (b"\x15\x01\x00\x00\x01\x06\xff" + READ_HOLDING, "tcp", "length 262"),
    ],
)
def test_what_is_no_frame_is_told(data: bytes, framing: Framing, match: str) -> None:
    with pytest.raises(FrameError, match=match):
        take_request(data, framing)


BODIES = (READ_COILS, READ_HOLDING, READ_INPUT, WRITE_COIL, WRITE_ONE, WRITE_MANY)


@given(st.sampled_from(BODIES), st.sampled_from(("tcp", "rtu")), st.binary())
def test_a_frame_is_taken_when_it_is_whole_and_no_sooner(body: bytes, framing: Framing, rest: bytes) -> None:
    frame = on_tcp(body) if framing == "tcp" else on_rtu(body)
    for end in range(len(frame)):
        assert take_request(frame[:end], framing) == (None, 0)
    request, used = take_request(frame + rest, framing)
    assert request is not None
    assert used == len(frame)
