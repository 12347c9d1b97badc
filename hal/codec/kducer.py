"""Register map of Kolver's tightening controllers K-Ducer (KDU-1A, firmware v40 and later) on Modbus TCP. Pure.

Addresses, layouts and units after the maker's own client (github.com/kolver/nuget-kolver.kducer, MIT, commit b5978b2):
`KDucer.cs` (addresses, lever, program and barcode), `KducerTighteningResult.cs`, `KducerTighteningProgram.cs`,
`KducerTorqueAngleTimeGraph.cs`; function codes after the operator's manual KDU-1A, "K-DUCER MODBUS map". Registers
count from the start of their block. Torques are in cN m, curves of small tools in mN m; angles in degrees.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hal.codec.registers import Image, RegisterError, RegisterField, Scaled, Text

# Coils. The first eight mirror the outputs of connector CN3, those from 32 on act as its inputs.
STATUS = ("lever", "forward", "ok", "nok", "end_program", "end_sequence", "stop_motor", "ready")
LEVER, STOP_MOTOR = 32, 34
"""The lever must be set again and again or the controller lets go of it; `stop_motor` keeps the spindle still."""

# Input registers: (start, count).
TOOL = (125, 4)
TORQUE_CURVE, ANGLE_CURVE = (152, 71), (223, 71)
NEW_RESULT = 294
"""Reads 1 once after each result and clears itself. Its answer can be lost: never a proof of anything."""
RESULT = (295, 67)
NUMBER = (354, 2)
"""The tightening's number within `RESULT`: 1 after power-up, one more for each result."""
VERSION = (370, 10)

# Holding registers. A change of the program empties the barcode.
SELECTED, MODE, BARCODE_SET = 7372, 7374, (7379, 8)
PROGRAM_SIZE = 115
MOST_PROGRAMS = 64
"""So many programs can be read without selecting them."""
NAME_LENGTH = 30
BARCODE, FIRMWARE = Text("barcode", 0, 8), Text("version", 0, 10)

_SMALL_TOOLS = (*range(5), 11)
"""Models (PL6, PL10, PL15, MT1.5, PL3, none) whose curves are in mN m."""
TOOLS = (
    "none", "KDS-PL6", "KDS-PL10", "KDS-PL15", "KDS-MT1.5", "KDS-PL20", "KDS-PL30", "KDS-PL35", "KDS-PL45", "KDS-PL50",
    "KDS-PL70", "KDS-PL3", "KDS-PL20S",
)  # fmt: skip


def _cnm(name: str, at: int) -> Scaled:
    return Scaled(name, at, per_unit=100)


_P_TORQUE, _P_HIGH, _P_LOW = _cnm("target torque", 1), _cnm("torque max", 3), _cnm("torque min", 5)
_P_ANGLE, _P_ANGLE_HIGH, _P_ANGLE_LOW = Scaled("target angle", 7), Scaled("angle max", 9), Scaled("angle min", 11)
_P_THRESHOLD, _P_SPEED = _cnm("angle starts at", 13), Scaled("final speed", 15)
_P_BY_ANGLE, _P_COUNTS_FROM = Scaled("torque/angle mode", 20, high=1), Scaled("angle start mode", 21, high=2)
_P_SWITCHES, _P_MAX_TIME = Scaled("switches", 22), Scaled("max time", 30, per_unit=10)
_P_BEFORE, _P_AFTER = Scaled("reverse before", 40, high=2), Scaled("reverse after", 47, high=2)
_P_NAME = Text("description", 68, 15)
_NO_REVERSE = 2
_TIMED, _ANTICLOCKWISE = 1 << 4, 1 << 12


@dataclass(frozen=True, slots=True)
class Program:
    """One of the controller's programs. `by_angle`: to an angle, watched by torque; else the other way round.

    Angles count from `threshold_nm` on, with 0 from the lever on. It ends NOK after `limit_s`; 0 is never. One that
    `reverses` turns back before or after.
    """

    name: str
    torque_nm: float
    torque_low_nm: float
    torque_high_nm: float
    angle_deg: float
    angle_low_deg: float
    angle_high_deg: float
    threshold_nm: float
    speed_rpm: float
    limit_s: float
    by_angle: bool
    clockwise: bool
    reverses: bool = False

    def __str__(self) -> str:
        way = ("clockwise" if self.clockwise else "anticlockwise") + (" and back" if self.reverses else "")
        if self.by_angle:
            limit = f"up to {self.torque_high_nm:g} N m at {self.speed_rpm:g} rpm"
            return f"{self.name!r} {way} by {self.angle_deg:g} deg {limit}"
        return (
            f"{self.name!r} {way} to {self.torque_nm:g} N m in {self.torque_low_nm:g} to {self.torque_high_nm:g}, "
            f"{self.angle_low_deg:g} to {self.angle_high_deg:g} deg from {self.threshold_nm:g} N m on, "
            f"at {self.speed_rpm:g} rpm within {self.limit_s:g} s"
        )

    @property
    def essence(self) -> Program:
        """Without the values that a program of its mode does not use; a turn may have a time limit or none."""
        if self.by_angle:
            return replace(self, torque_nm=0.0, angle_low_deg=0.0, angle_high_deg=0.0, limit_s=0.0)
        return replace(self, angle_deg=0.0)


def stage(
    name: str,
    torque_nm: tuple[float, float, float],
    angle_deg: tuple[float, float],
    threshold_nm: float,
    speed_rpm: float,
    limit_s: float,
    *,
    clockwise: bool,
) -> Program:
    """Tightening to a torque: (low, high, target), within angles (low, high), in the steps of the registers.

    Raises RegisterError where a value does not fit.
    """
    low, high, target = torque_nm
    told = Program(
        name, target, low, high, 0.0, *angle_deg, threshold_nm, speed_rpm, limit_s, by_angle=False, clockwise=clockwise
    )
    return read_program(program_words(told))


def turn(angle_deg: float, speed_rpm: float, torque_limit_nm: float) -> Program:
    """Turning by an angle (positive is clockwise) up to a torque. Raises as `stage`."""
    told = Program(
        "turn", 0.0, 0.0, torque_limit_nm, abs(angle_deg), 0.0, 0.0, 0.0, speed_rpm, 0.0, by_angle=True,
        clockwise=angle_deg >= 0.0,
    )  # fmt: skip
    return read_program(program_words(told))


def program_words(program: Program) -> tuple[int, ...]:
    """Registers of `program`. Raises RegisterError where a value does not fit."""
    switches = (_TIMED if program.limit_s else 0) | (0 if program.clockwise else _ANTICLOCKWISE)
    values: tuple[tuple[RegisterField[float], float], ...] = (
        (_P_TORQUE, program.torque_nm),
        (_P_LOW, program.torque_low_nm),
        (_P_HIGH, program.torque_high_nm),
        (_P_ANGLE, program.angle_deg),
        (_P_ANGLE_LOW, program.angle_low_deg),
        (_P_ANGLE_HIGH, program.angle_high_deg),
        (_P_THRESHOLD, program.threshold_nm),
        (_P_SPEED, program.speed_rpm),
        (_P_MAX_TIME, program.limit_s),
        (_P_BY_ANGLE, program.by_angle),
        (_P_COUNTS_FROM, 0 if program.threshold_nm else 1),
        (_P_SWITCHES, switches),
    )
    words = [0] * PROGRAM_SIZE
    for field, value in values:
        (words[field.at],) = field.encode(value)
    words[_P_BEFORE.at], words[_P_AFTER.at] = _NO_REVERSE, 0 if program.reverses else _NO_REVERSE
    words[_P_NAME.at : _P_NAME.at + _P_NAME.size] = _P_NAME.encode(program.name)
    return tuple(words)


def read_program(words: Sequence[int]) -> Program:
    """What `PROGRAM_SIZE` registers say. Raises RegisterError."""
    image = Image(0, tuple(words))
    switches = _whole(image, _P_SWITCHES)
    return Program(
        name=image[_P_NAME],
        torque_nm=image[_P_TORQUE],
        torque_low_nm=image[_P_LOW],
        torque_high_nm=image[_P_HIGH],
        angle_deg=image[_P_ANGLE],
        angle_low_deg=image[_P_ANGLE_LOW],
        angle_high_deg=image[_P_ANGLE_HIGH],
        threshold_nm=image[_P_THRESHOLD] if image[_P_COUNTS_FROM] == 0 else 0.0,
        speed_rpm=image[_P_SPEED],
        limit_s=image[_P_MAX_TIME] if switches & _TIMED else 0.0,
        by_angle=image[_P_BY_ANGLE] == 1,
        clockwise=not switches & _ANTICLOCKWISE,
        reverses=not image[_P_BEFORE] == image[_P_AFTER] == _NO_REVERSE,
    )


_OK, _PROGRAM, _MODEL = Scaled("ok", 8, high=1), Scaled("program", 9), Scaled("tool", 10)
_TIME, _TORQUE, _PEAK = Scaled("time", 17, per_unit=1000), _cnm("torque", 23), _cnm("peak torque", 24)
_ANGLE, _CODE, _NAME = Scaled("angle", 28), Scaled("result code", 35), Text("description", 36, 15)
_STAMP = tuple(Scaled("clock", at, high=99) for at in range(51, 57))
_LOW, _HIGH = _cnm("torque min", 61), _cnm("torque max", 62)
_ANGLE_LOW, _ANGLE_HIGH = Scaled("angle min", 63), Scaled("angle max", 64)
_SERIAL_AT, _NUMBER_AT = 11, NUMBER[0] - RESULT[0]

SCREW_OK, ANGLE_OK, TOO_LONG, UNDER_TORQUE, OVER_TORQUE, OVER_ANGLE, UNDER_ANGLE = 13, 14, 18, 31, 32, 34, 35
CODES = {
    13: "screw OK", 14: "angle OK", 15: "reverse torque OK", 16: "run time OK", 17: "under min time",
    18: "over max time", 21: "prevailing torque", 22: "reverse torque", 23: "auto reverse incomplete",
    24: "angle not reached", 25: "lever released", 26: "overcurrent", 27: "overcurrent", 28: "overcurrent",
    29: "temperature", 30: "motor protection", 31: "under min torque", 32: "over max torque", 34: "over max angle",
    35: "under min angle", 36: "pre-reverse incomplete", 38: "tool connection", 39: "running torque incomplete",
    40: "running torque low", 41: "running torque high",
}  # fmt: skip
"""What the result codes mean."""


@dataclass(frozen=True, slots=True)
class Result:
    """The last tightening. `stamp` is year (of 2000), month, day, hour, minute, second of the controller's clock.

    The limits are those by which it was judged. Where nothing was tightened since power-up `number` is 0.
    """

    barcode: str
    number: int
    ok: bool
    program: int
    tool: int
    tool_serial: int
    seconds: float
    torque_nm: float
    peak_nm: float
    angle_deg: float
    code: int
    name: str
    stamp: tuple[int, int, int, int, int, int]
    torque_low_nm: float = 0.0
    torque_high_nm: float = 0.0
    angle_low_deg: float = 0.0
    angle_high_deg: float = 0.0

    @property
    def stamped_number(self) -> int:
        """Unlike `number` it grows across power-ups: seconds since 2000, every month with 31 days, then the number."""
        year, month, day, hour, minute, second = self.stamp
        seconds = ((((year * 12 + month) * 31 + day) * 24 + hour) * 60 + minute) * 60 + second
        return seconds << 20 | self.number & 0xFFFFF


def result_words(result: Result) -> tuple[int, ...]:
    """The result block. Raises RegisterError where a value does not fit."""
    values: tuple[tuple[RegisterField[float], float], ...] = (
        (_OK, result.ok),
        (_PROGRAM, result.program),
        (_MODEL, result.tool),
        (_TIME, result.seconds),
        (_TORQUE, result.torque_nm),
        (_PEAK, result.peak_nm),
        (_ANGLE, result.angle_deg),
        (_CODE, result.code),
        (_LOW, result.torque_low_nm),
        (_HIGH, result.torque_high_nm),
        (_ANGLE_LOW, result.angle_low_deg),
        (_ANGLE_HIGH, result.angle_high_deg),
        *zip(_STAMP, result.stamp, strict=True),
    )
    words = [0] * RESULT[1]
    for field, value in values:
        (words[field.at],) = field.encode(value)
    for text, said in ((BARCODE, result.barcode), (_NAME, result.name)):
        words[text.at : text.at + text.size] = text.encode(said)
    words[_SERIAL_AT : _SERIAL_AT + 2] = split(result.tool_serial)
    words[_NUMBER_AT : _NUMBER_AT + 2] = split(result.number)
    return tuple(words)


def read_result(words: Sequence[int]) -> Result:
    """What the result block says. Raises RegisterError."""
    image = Image(0, tuple(words))
    year, month, day, hour, minute, second = (_whole(image, field) for field in _STAMP)
    return Result(
        barcode=image[BARCODE],
        number=joined(words[_NUMBER_AT : _NUMBER_AT + 2]),
        ok=image[_OK] == 1,
        program=_whole(image, _PROGRAM),
        tool=_whole(image, _MODEL),
        tool_serial=joined(words[_SERIAL_AT : _SERIAL_AT + 2]),
        seconds=image[_TIME],
        torque_nm=image[_TORQUE],
        peak_nm=image[_PEAK],
        angle_deg=image[_ANGLE],
        code=_whole(image, _CODE),
        name=image[_NAME],
        stamp=(year, month, day, hour, minute, second),
        torque_low_nm=image[_LOW],
        torque_high_nm=image[_HIGH],
        angle_low_deg=image[_ANGLE_LOW],
        angle_high_deg=image[_ANGLE_HIGH],
    )


def _whole(image: Image, field: RegisterField[float]) -> int:
    value = image[field]
    return round(value)


def barcode_of(key: str) -> str:
    """`key` in the 16 characters that are kept with a result: itself, or 15 characters of its hash behind a #."""
    if re.fullmatch(r"[A-Za-z0-9._-]{1,16}", key):
        return key
    return "#" + base64.b32encode(hashlib.blake2s(key.encode(), digest_size=9).digest()).decode("ascii").rstrip("=")


def joined(words: Sequence[int]) -> int:
    """A number in two registers, the high one first."""
    high, low = words
    return high << 16 | low


def split(number: int) -> tuple[int, int]:
    """Two registers of `number`. Raises RegisterError."""
    if not 0 <= number <= 0xFFFFFFFF:
        raise RegisterError(f"{number} does not fit into two registers (limit 0 to {0xFFFFFFFF})")
    return number >> 16, number & 0xFFFF


@dataclass(frozen=True, slots=True)
class Curve:
    """Up to 70 points (n,) at equal intervals from the start on."""

    time_s: NDArray[np.float64]
    angle_deg: NDArray[np.float64]
    torque_nm: NDArray[np.float64]


def read_curve(torque: Sequence[int], angle: Sequence[int], tool: int) -> Curve:
    """Curve of the last result: an interval in ms, then points; those behind the last turn of the spindle are empty."""
    turned = np.flatnonzero(angle[1:])
    count = int(turned[-1]) + 1 if len(turned) else 0
    per_nm = 1000.0 if tool in _SMALL_TOOLS else 100.0
    return Curve(
        time_s=1e-3 * torque[0] * np.arange(count, dtype=np.float64),
        angle_deg=np.asarray(angle[1 : count + 1], dtype=np.float64),
        torque_nm=np.asarray(torque[1 : count + 1], dtype=np.float64) / per_nm,
    )


def closed(curve: Curve, result: Result) -> Curve:
    """The curve up to the stop: its last point lies before, and the result tells time and peak. Empty stays empty."""
    if not len(curve.time_s):
        return curve
    end_s = max(result.seconds, curve.time_s[-1] + 1e-3)
    return Curve(
        np.append(curve.time_s, end_s),
        np.append(curve.angle_deg, curve.angle_deg[-1]),
        np.append(curve.torque_nm, result.peak_nm),
    )


def curve_words(curve: Curve, tool: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Torque and angle registers of a curve of at most 70 points."""
    per_nm = 1000.0 if tool in _SMALL_TOOLS else 100.0
    interval = round(1e3 * float(curve.time_s[1])) if len(curve.time_s) > 1 else 0
    rest = (0,) * (TORQUE_CURVE[1] - 1 - len(curve.time_s))
    torque = np.clip(np.round(curve.torque_nm * per_nm), 0, 0xFFFF).astype(int)
    angle = np.clip(np.round(curve.angle_deg), 0, 0xFFFF).astype(int)
    return (interval, *map(int, torque), *rest), (interval, *map(int, angle), *rest)
