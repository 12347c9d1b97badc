"""Messages between controller and guard: what is said comes through, in whatever pieces, and nonsense is refused."""

from __future__ import annotations

import math

import pytest

from hal.codec.guard import (
    GuardMessageError,
    Kind,
    decode_frame,
    decode_object,
    encode,
    encode_frame,
    encode_object,
    split,
)
from hal.codec.lawicel import CanFrame

GOLDEN = [
    (encode(Kind.BEAT), "010002"),
    (encode_frame(CanFrame(0x203, bytes.fromhex("020001")), 7), "0d00" "01" "07000000" "03020000" "00" "020001"),
    (encode_frame(CanFrame(0x1ABCDEF0, b"", extended=True, remote=True), 1), "0a00" "01" "01000000" "f0debc1a" "03"),
    (encode_object(Kind.CALL, {"tag": 1}), "0b00" "03" + b'{"tag": 1}'.hex()),
]  # fmt: skip


@pytest.mark.parametrize(("message", "bytes_hex"), GOLDEN)
def test_golden_vectors(message: bytes, bytes_hex: str) -> None:
    assert message.hex() == bytes_hex


def test_messages_come_through_in_whatever_pieces() -> None:
    stream = b"".join(message for message, _ in GOLDEN)
    whole, rest = split(stream)
    assert (len(whole), rest) == (len(GOLDEN), b"")
    for size in (1, 2, 3, 5):
        pieces, found = b"", []
        for start in range(0, len(stream), size):
            some, pieces = split(pieces + stream[start : start + size])
            found += some
        assert found == whole


def test_frames_and_objects_are_what_they_were() -> None:
    for frame in (CanFrame(0), CanFrame(0x7FF, bytes(range(8))), CanFrame(0x1FFFFFFF, b"\0", extended=True)):
        assert decode_frame(split(encode_frame(frame, 12))[0][0][1]) == (frame, 12)
    values = decode_object(encode_object(Kind.STATE, {"peak_n": math.nan, "stale_ms": math.inf})[3:])
    assert math.isnan(values["peak_n"])
    assert values["stale_ms"] == math.inf


@pytest.mark.parametrize("data", [b"\x00\x00\x01", b"\xff\xff\x01", b"\x01\x00\x09", b"\x01\x00\x00"])
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(GuardMessageError):
        split(data)


@pytest.mark.parametrize("body", [b"", b"12345678", bytes(18)])
def test_what_is_no_frame_is_refused(body: bytes) -> None:
    with pytest.raises(GuardMessageError, match="frame"):
        decode_frame(body)


@pytest.mark.parametrize("body", [b"", b"[1]", b"{", b"\xff"])
def test_what_is_no_object_is_refused(body: bytes) -> None:
    with pytest.raises(GuardMessageError, match="object"):
        decode_object(body)
