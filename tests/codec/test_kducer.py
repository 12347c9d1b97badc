"""Kolver's registers against the results that the maker's own client is tested with, and there and back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.codec import kducer as k
from hal.codec.registers import RegisterError

SCREW_OK = (
    "65 66 67 45 97 98 99 45 49 50 51 52 0 0 0 0 0 1 0 51 0 4 0 30 162 221 1 115 3 232 0 50 1 44 2 56 0 1 0 1 "
    + "0 0 0 0 0 0 0 50 0 50 0 8 0 3 0 50 3 231 0 0 0 0 0 0 0 0 2 88 0 0 0 13"
    + 30 * " 0"
    + " 0 24 0 3 0 15 0 15 0 15 0 38 0 0 0 0 0 0 0 5 0 0 0 0 0 0 0 0 0 0 48 52"
)
"""github.com/kolver/nuget-kolver.kducer, KducerTests.cs, TestGetXYZFromPrebakedresult: the second one."""


def registers(said: str) -> tuple[int, ...]:
    data = bytes(map(int, said.split()))
    return tuple(int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2))


def test_a_result_of_the_makers_own_tests() -> None:
    words = registers(SCREW_OK)
    assert len(words) == k.RESULT[1]
    result = k.read_result(words)
    assert (result.barcode, result.ok, result.program, result.number) == ("ABC-abc-1234", True, 51, 5)
    assert (k.TOOLS[result.tool], result.tool_serial) == ("KDS-MT1.5", 2007773)
    assert (result.torque_nm, result.peak_nm, result.angle_deg, result.seconds) == (0.5, 0.5, 999.0, 0.568)
    assert k.CODES[result.code] == "screw OK"
    assert result.stamp == (24, 3, 15, 15, 15, 38)
    assert result.torque_high_nm == 0.0, "v37 does not tell its limits"


PROGRAMS = st.builds(
    k.Program,
    name=st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=k.NAME_LENGTH),
    torque_nm=st.integers(0, 65535).map(lambda n: n / 100),
    torque_low_nm=st.integers(0, 65535).map(lambda n: n / 100),
    torque_high_nm=st.integers(0, 65535).map(lambda n: n / 100),
    angle_deg=st.integers(0, 65535).map(float),
    angle_low_deg=st.integers(0, 65535).map(float),
    angle_high_deg=st.integers(0, 65535).map(float),
    threshold_nm=st.integers(0, 65535).map(lambda n: n / 100),
    speed_rpm=st.integers(0, 65535).map(float),
    limit_s=st.integers(0, 65535).map(lambda n: n / 10),
    by_angle=st.booleans(),
    clockwise=st.booleans(),
    reverses=st.booleans(),
)


@given(PROGRAMS)
def test_programs_go_there_and_back(program: k.Program) -> None:
    words = k.program_words(program)
    assert len(words) == k.PROGRAM_SIZE
    assert k.read_program(words) == program


RESULTS = st.builds(
    k.Result,
    barcode=st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16),
    number=st.integers(0, 0xFFFFFFFF),
    ok=st.booleans(),
    program=st.integers(1, 200),
    tool=st.integers(0, 12),
    tool_serial=st.integers(0, 0xFFFFFFFF),
    seconds=st.integers(0, 65535).map(lambda n: n / 1000),
    torque_nm=st.integers(0, 65535).map(lambda n: n / 100),
    peak_nm=st.integers(0, 65535).map(lambda n: n / 100),
    angle_deg=st.integers(0, 65535).map(float),
    code=st.integers(0, 41),
    name=st.just("final"),
    stamp=st.just((26, 11, 25, 22, 0, 59)),
)


@given(RESULTS)
def test_results_go_there_and_back(result: k.Result) -> None:
    assert k.read_result(k.result_words(result)) == result


@pytest.mark.parametrize(("tool", "resolution_nm"), [(4, 0.001), (7, 0.01)])
def test_curves_go_there_and_back_in_the_tools_own_unit(tool: int, resolution_nm: float) -> None:
    time_s = 0.02 * np.arange(60)
    curve = k.Curve(time_s, np.round(300.0 * time_s + 1.0), 5.0 * time_s)
    torque, angle = k.curve_words(curve, tool)
    assert (len(torque), len(angle)) == (k.TORQUE_CURVE[1], k.ANGLE_CURVE[1])
    back = k.read_curve(torque, angle, tool)
    assert np.allclose(back.time_s, time_s)
    assert np.array_equal(back.angle_deg, curve.angle_deg)
    assert np.abs(back.torque_nm - curve.torque_nm).max() <= 0.5 * resolution_nm + 1e-12


def test_no_curve_is_an_empty_one() -> None:
    empty = (0,) * k.TORQUE_CURVE[1]
    assert len(k.read_curve(empty, empty, 4).time_s) == 0


@pytest.mark.parametrize(
    ("wrong", "match"),
    [({"torque_nm": -1.0}, "target torque"), ({"speed_rpm": math.nan}, "speed"), ({"name": "x" * 31}, "30 bytes")],
)
def test_what_does_not_fit_is_told(wrong: dict[str, object], match: str) -> None:
    program = k.stage("snug", (9.0, 11.0, 10.0), (0.0, 7200.0), 6.0, 60.0, 30.0, clockwise=True)
    with pytest.raises(RegisterError, match=match):
        k.program_words(replace(program, **wrong))  # type: ignore[arg-type]


def test_a_result_that_cannot_be_is_told() -> None:
    words = list(registers(SCREW_OK))
    words[8] = 7
    with pytest.raises(RegisterError, match="ok at register 8"):
        k.read_result(words)


@given(st.text(), st.text())
def test_different_keys_have_different_barcodes_that_fit(one: str, other: str) -> None:
    assert len(k.BARCODE.encode(k.barcode_of(one))) == k.BARCODE_SET[1]
    assert (k.barcode_of(one) == k.barcode_of(other)) == (one == other)


def test_numbers_grow_across_power_ups() -> None:
    result = k.read_result(registers(SCREW_OK))
    later = replace(result, number=1, stamp=(24, 3, 15, 15, 15, 39))
    assert result.stamped_number < later.stamped_number < 2**53
