"""Values in registers: golden vectors, limits, and maps that hang together."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.codec import maps
from hal.codec.registers import Bits, Block, Float, Image, RegisterError, Scaled, Text


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        (Float("f", 0), 123.456, (0x42F6, 0xE979)),  # IEEE 754: 123.456 is 42F6E979
        (Float("f", 0, order="low_first"), 123.456, (0xE979, 0x42F6)),
        (Float("f", 0), -1.0, (0xBF80, 0x0000)),
        (Scaled("s", 0, per_unit=10, signed=True), -12.3, (0xFF85,)),
        (Scaled("s", 0, per_unit=100), 6.0, (600,)),
        (Scaled("s", 0), 65535.0, (0xFFFF,)),
        (Bits("b", 0, ("a", "b", "c")), frozenset("ac"), (0b101,)),
        (Text("t", 0, 3), "S-7", (0x532D, 0x3700, 0x0000)),
        (Text("t", 0, 2), "°C", (0xC2B0, 0x4300)),
    ],
)
def test_golden(field: Any, value: Any, words: tuple[int, ...]) -> None:
    assert field.encode(value) == words
    decoded = field.decode(words)
    assert decoded == (pytest.approx(value, rel=1e-7) if isinstance(value, float) else value)


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        (Scaled("pressure_bar", 3, per_unit=100), 655.36, "pressure_bar at register 3: 655.36 does not fit"),
        (Scaled("count", 3), -1.0, "limit 0 to 65535"),
        (Scaled("emissivity", 4, per_unit=1000, low=0.05, high=1.1), 1.2, "out of range .limit 0.05 to 1.1"),
        (Scaled("count", 3), math.nan, "out of range"),
        (Float("setpoint_c", 16), 1e39, "setpoint_c at register 16: 1e.39 does not fit"),
        (Text("rotor", 0, 2), "R-123", "limit 4 bytes"),
        (Bits("outputs", 0, ("clamp",)), frozenset(("grip",)), "no bit .'grip'"),
    ],
)
def test_what_does_not_fit_is_told_with_place_and_limit(field: Any, value: Any, match: str) -> None:
    with pytest.raises(RegisterError, match=match):
        field.encode(value)


def test_registers_that_hold_no_such_value_are_told() -> None:
    with pytest.raises(RegisterError, match="rotor at register 0: no text"):
        Text("rotor", 0, 1).decode((0xFFFE,))
    with pytest.raises(RegisterError, match="out of range"):
        Scaled("emissivity", 4, per_unit=1000, low=0.05, high=1.1).decode((1500,))
    with pytest.raises(RegisterError, match="not among registers 0 to 1"):
        Image(0, (1, 2))[Float("power_w", 1)]


def test_a_block_of_another_size_is_not_taken() -> None:
    with pytest.raises(RegisterError, match="3 came, 4 were asked for"):
        maps.THERMOCOUPLE.image((1, 2, 3))
    with pytest.raises(RegisterError, match="must begin at register 2"):
        Block((Float("a", 0), Float("b", 3)))


@given(st.floats(width=32, allow_nan=False), st.sampled_from(("high_first", "low_first")))
def test_every_binary32_comes_back(value: float, order: Any) -> None:
    field = Float("f", 0, order=order)
    assert field.decode(field.encode(value)) == value


@given(st.integers(0, 0xFFFF), st.booleans(), st.sampled_from((1, 10, 1000)))
def test_every_register_comes_back(word: int, signed: bool, per_unit: int) -> None:
    field = Scaled("s", 0, per_unit, signed)
    assert field.encode(field.decode((word,))) == (word,)


def test_blocks_of_the_maps_fit_one_exchange() -> None:
    blocks = [block for block in vars(maps).values() if isinstance(block, Block)]
    assert len(blocks) >= 15
    assert all(block.size <= 123 for block in blocks)
