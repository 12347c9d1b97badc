"""LAWICEL lines: examples of the CAN232 manual, and what is no line."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.codec.lawicel import CanFrame, LawicelError, decode, encode, split

MANUAL = {
    b"t10021133": CanFrame(0x100, b"\x11\x33"),
    b"T0000010021133": CanFrame(0x100, b"\x11\x33", extended=True),
    b"r1000": CanFrame(0x100, remote=True),
    b"R000001000": CanFrame(0x100, extended=True, remote=True),
    b"t7FF0": CanFrame(0x7FF),
}


@pytest.mark.parametrize(("line", "frame"), MANUAL.items())
def test_examples_of_the_manual(line: bytes, frame: CanFrame) -> None:
    assert decode(line) == frame
    assert encode(frame) == line + b"\r"


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_every_frame_comes_back(can_id: int, data: bytes) -> None:
    frame = CanFrame(can_id, data)
    lines, rest = split(encode(frame) * 2)
    assert ([decode(line) for line in lines], rest) == ([frame, frame], b"")


@pytest.mark.parametrize(
    "line", [b"", b"t", b"t10", b"t1009", b"t1002113", b"t100211", b"t10021133FF", b"t10G0", b"r10021133", b"x", b"z"]
)
def test_what_is_no_line_is_refused(line: bytes) -> None:
    with pytest.raises(LawicelError):
        decode(line)


@pytest.mark.parametrize("frame", [CanFrame(0x800), CanFrame(-1), CanFrame(0x20000000, extended=True)])
def test_an_identifier_out_of_range_is_refused(frame: CanFrame) -> None:
    with pytest.raises(LawicelError, match="identifier"):
        encode(frame)


def test_too_much_data_is_refused() -> None:
    with pytest.raises(LawicelError, match="9 bytes"):
        encode(CanFrame(1, bytes(9)))


def test_a_part_of_a_line_waits_for_its_rest_and_endless_noise_is_dropped() -> None:
    assert split(b"t1000\rt10") == ([b"t1000"], b"t10")
    assert split(b"\at1000\a") == ([b"", b"t1000"], b"")
    assert split(b"x" * 65) == ([], b"")
