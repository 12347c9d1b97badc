"""Lines of the force amplifier: fixed bytes, round trips, and what is no line."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.codec.force_line import (
    LONGEST,
    ForceLineError,
    IdentityTold,
    Message,
    Request,
    Sample,
    StateTold,
    checksum,
    decode,
    encode,
    split,
)


def crc_bit_by_bit(data: bytes) -> int:
    """CRC-16/IBM-3740 as its definition has it."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
            crc &= 0xFFFF
    return crc


def test_the_checksum_has_the_published_check_value() -> None:
    assert checksum(b"123456789") == b"29B1"


@given(st.binary(max_size=60))
def test_the_checksum_is_that_of_its_definition(data: bytes) -> None:
    assert int(checksum(data), 16) == crc_bit_by_bit(data)


GOLDEN: list[tuple[Message, bytes]] = [
    (Sample(0x00A3, 980.665), b"F 00A3 +980.6650"),
    (Sample(0xFFFF, -0.5), b"F FFFF -0.5000"),
    (Sample(1, math.inf), b"F 0001 +OVR"),
    (Sample(2, -math.inf), b"F 0002 -OVR"),
    (Request(17, "start"), b"? 17 start"),
    (IdentityTold(1, "maker", "amplifier 3", "A-7", "2.1", 1000.0, 2000.0), b"I 1 maker|amplifier 3|A-7|2.1|1000|2000"),
    (StateTold(17, True), b"S 17 streaming"),
    (StateTold(18, False), b"S 18 idle"),
]


@pytest.mark.parametrize(("message", "payload"), GOLDEN)
def test_messages_are_these_bytes(message: Message, payload: bytes) -> None:
    line = payload + b"*%04X" % crc_bit_by_bit(payload)
    assert encode(message) == line + b"\n"
    assert decode(line) == message
    assert decode(line + b"\r") == message


def test_no_signal_is_no_number() -> None:
    line = encode(Sample(5, math.nan))
    assert line == b"F 0005 NAN*%04X\n" % crc_bit_by_bit(b"F 0005 NAN")
    sample = decode(line[:-1])
    assert isinstance(sample, Sample)
    assert math.isnan(sample.force_n)


@given(st.integers(0, 0xFFFF), st.floats(-9e5, 9e5))
def test_samples_come_back_to_a_tenth_of_a_millinewton(sequence: int, force_n: float) -> None:
    sample = decode(encode(Sample(sequence, force_n))[:-1])
    assert isinstance(sample, Sample)
    assert sample.sequence == sequence
    assert abs(sample.force_n - force_n) <= 5.0001e-5


@given(st.integers(0, 0xFFFF), st.floats(-2000, 2000), st.data())
def test_a_sample_with_one_or_two_wrong_bits_is_none(sequence: int, force_n: float, data: st.DataObject) -> None:
    line = bytearray(encode(Sample(sequence, force_n))[:-1])
    bits = data.draw(st.sets(st.integers(0, 8 * len(line) - 1), min_size=1, max_size=2))
    for bit in bits:
        line[bit // 8] ^= 1 << bit % 8
    with pytest.raises(ForceLineError):
        decode(bytes(line))


@given(st.binary(max_size=300))
def test_whatever_comes_is_a_message_or_names_place_and_reason(data: bytes) -> None:
    with pytest.raises(ForceLineError) as caught:
        decode(data)
    assert caught.value.place
    assert caught.value.reason


@pytest.mark.parametrize("payload", [b"F 0A3 +1.0000", b"F 00A3 1e3", b"F 00A3 +nan", b"? 1 dance", b"S 1 asleep", b""])
def test_a_true_checksum_saves_no_unknown_payload(payload: bytes) -> None:
    with pytest.raises(ForceLineError, match="payload"):
        decode(payload + b"*" + checksum(payload))


@given(st.lists(st.binary(max_size=20).filter(lambda line: b"\n" not in line)), st.integers(1, 7))
def test_lines_are_the_same_however_they_are_cut(lines: list[bytes], size: int) -> None:
    data = b"".join(line + b"\n" for line in lines)
    found: list[bytes] = []
    rest = b""
    for at in range(0, len(data), size):
        more, rest = split(rest + data[at : at + size])
        found += more
    assert (found, rest) == (lines, b"")


def test_an_endless_line_does_not_grow() -> None:
    lines, rest = split(b"x" * 100_000)
    assert not lines
    assert len(rest) == LONGEST
