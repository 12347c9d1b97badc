"""Open Protocol: MID 0900 in both directions, and what is wrong with one that cannot be told."""

from __future__ import annotations

import numpy as np
import pytest

from hal.codec.open_protocol import Framer, Message, OpenProtocolError, encode
from hal.codec.open_protocol_messages import TRACE
from hal.codec.open_protocol_trace import (
    ANGLE,
    TORQUE,
    Curve,
    Order,
    curve,
    of_result,
    read_curve,
    read_of_result,
    read_wanted,
    wanted,
)

TEXT = (
    b"0000000007" + b"2018-06-04:15:00:00" + b"001" + b"01234" b"003" b"01" b"000" b"0002" b"abc"
    b"02" b"01" b"001" b"001" b"02213" b"003" b"03" b"000" b"0000" b"100"
    b"002" b"00000" b"00001" b"004" b"03" b"202" b"2.00" b"00002" b"00003" b"005" b"03" b"200" b"0.001"
    b"00004"
)  # fmt: skip
"""Fields as the specification lays them out: one field, a divisor of 100, 2 ms and then 1 ms between samples."""
SAMPLES = (0, 250, -100, 32767)


def message(text: bytes = TEXT, samples: bytes = np.array(SAMPLES, ">i2").tobytes()) -> Message:
    return Message(TRACE, text + b"\0" + samples)


@pytest.mark.parametrize("order", ["big", "little"])
def test_a_curve_laid_out_by_hand_is_read(order: Order) -> None:
    samples = np.array(SAMPLES, ">i2" if order == "big" else "<i2").tobytes()
    value = read_curve(message(samples=samples), order)
    assert (value.result, value.stamp, value.kind) == (7, "2018-06-04:15:00:00", TORQUE)
    assert value.values == pytest.approx([0.0, 2.5, -1.0, 327.67])
    assert value.time_s == pytest.approx([0.0, 0.002, 0.003, 0.004])


def test_millinewton_metres_are_newton_metres() -> None:
    value = read_curve(message(TEXT.replace(b"0201001001", b"0201090001")))
    assert value.values == pytest.approx([0.0, 2.5e-3, -1e-3, 0.32767])


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize("seed", range(10))
def test_a_curve_that_is_written_is_read(seed: int, order: Order) -> None:
    rng = np.random.default_rng(seed)
    steps = ((int(rng.integers(1, 900)), 0.01), (int(rng.integers(1, 2000)), 0.001))
    count = sum(n for n, _ in steps)
    time_s = np.cumsum(np.concatenate([np.full(n, s) for n, s in steps]))
    time_s -= time_s[0]
    kind = (ANGLE, TORQUE)[seed % 2]
    scale = float(10.0 ** rng.uniform(-2, 4))
    truth = Curve(int(rng.integers(1, 10**9)), "2026-01-01:00:00:00", kind, time_s, scale * rng.standard_normal(count))
    (sent,) = Framer().feed(encode(curve(truth, steps, order)))
    value = read_curve(sent, order)
    assert (value.result, value.kind) == (truth.result, kind)
    assert np.abs(value.values - truth.values).max() <= np.abs(truth.values).max() / 32000.0
    assert value.time_s == pytest.approx(truth.time_s, abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "place"),
    [
        (Message(TRACE, TEXT), "MID 0900"),
        (message(TEXT[:30]), "number of fields"),
        (message(samples=b"\0" * 6), "samples"),
        (message(TEXT.replace(b"0201001", b"0201050")), "unit"),
        (message(TEXT.replace(b"0000000100", b"0000000000")), "02213"),
        (message(TEXT.replace(b"2.00", b"0.00")), "resolution"),
        (message(TEXT.replace(b"0000200003", b"0000200002")), "resolutions"),
        (message(b"x" + TEXT[1:]), "result"),
    ],
)
def test_a_curve_that_cannot_be_told_is_refused_with_its_place(wrong: Message, place: str) -> None:
    with pytest.raises(OpenProtocolError) as caught:
        read_curve(wrong)
    assert place in caught.value.place


def test_what_is_asked_for_is_read_back() -> None:
    assert wanted((ANGLE, TORQUE, 3)) == b"000000000000000000000000000000" + b"03001002003"
    assert read_wanted(wanted((ANGLE, TORQUE))) == (ANGLE, TORQUE)
    assert read_of_result(of_result(42, TORQUE)) == (42, TORQUE)
