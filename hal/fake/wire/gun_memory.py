"""What a simulated tightening controller is programmed with and what it remembers, whoever is connected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from hal.codec import open_protocol_messages as m
from hal.codec import open_protocol_trace as t
from hal.codec.open_protocol import Message
from hal.codec.open_protocol_result import Result
from hal.interfaces import Band, TighteningProgram, TighteningResult, Trace, TurnResult

STATUS = {Band.LOW: 0, Band.OK: 1, Band.HIGH: 2}
FULL = 3000
"""So many samples before the stop are told at full rate; what comes before is thinned until it fits a message."""
EPOCH = datetime(2026, 1, 1)


@dataclass(frozen=True, slots=True)
class TurnProgram:
    """A parameter set that turns by an angle (positive tightens) and stops early at a torque."""

    angle_deg: float
    speed_rpm: float
    torque_limit_nm: float


Program = TighteningProgram | TurnProgram


def told(number: int, program: Program) -> m.ParameterSet:
    """What the controller tells of one of its parameter sets."""
    if isinstance(program, TurnProgram):
        size, limit = abs(program.angle_deg), program.torque_limit_nm
        direction = 1 if program.angle_deg >= 0.0 else 2
        values = m.told_set("turn", program.speed_rpm, direction, (0.0, limit, limit), (0.0, size, size))
    else:
        values = m.told_set(
            program.stage,
            program.speed_rpm,
            1 if program.direction == "tighten" else 2,
            (program.torque_low_nm, program.torque_high_nm, program.target_torque_nm),
            (program.angle_low_deg, program.angle_high_deg, 0.0),
        )
    return replace(values, number=number)


def stamp(now_s: float) -> str:
    """Time as the protocol writes it."""
    return (EPOCH + timedelta(seconds=now_s)).strftime("%Y-%m-%d:%H:%M:%S")


@dataclass(frozen=True, slots=True)
class Record:
    """One stored tightening; a turn has no trace."""

    result: Result
    trace: Trace | None = None


def of_tightening(number: int, identifier: str, chosen: m.ParameterSet, done: TighteningResult) -> Record:
    """What is stored of a program that ended."""
    result = _result(number, identifier, chosen, done.torque_nm, done.angle_deg, done.time_s)
    torque, angle = STATUS[done.torque_band], STATUS[done.angle_band]
    return Record(replace(result, ok=done.ok, torque_status=torque, angle_status=angle), done.trace)


def of_turn(number: int, identifier: str, chosen: m.ParameterSet, done: TurnResult) -> Record:
    """What is stored of a turn that ended."""
    return Record(_result(number, identifier, chosen, done.peak_torque_nm, abs(done.angle_deg), done.time_s))


def _result(
    number: int, identifier: str, chosen: m.ParameterSet, torque_nm: float, angle_deg: float, time_s: float
) -> Result:
    return Result(
        number=number,
        identifier=identifier,
        parameter_set=chosen.number,
        ok=True,
        torque_status=1,
        angle_status=1,
        torque_nm=max(round(torque_nm, 2), 0.0),
        angle_deg=max(round(angle_deg), 0),
        stamp=stamp(time_s),
        cell=1,
        channel=1,
        torque_low_nm=chosen.torque_low_nm,
        torque_high_nm=chosen.torque_high_nm,
        target_torque_nm=chosen.torque_nm,
        angle_low_deg=chosen.angle_low_deg,
        angle_high_deg=chosen.angle_high_deg,
        target_angle_deg=chosen.angle_deg,
        changed=stamp(0.0),
    )


def curve(record: Record, kind: int, order: t.Order) -> Message | None:
    """MID 0900 of a stored tightening; the angle counts from its first sample. None where there is no trace."""
    trace = record.trace
    if trace is None:
        return None
    count = len(trace.time_s)
    period_s = float(trace.time_s[1] - trace.time_s[0]) if count > 1 else 1e-3
    kept = np.arange(count)
    steps: tuple[tuple[int, float], ...] = ((count, period_s),)
    if count > t.MOST:
        turn = count - FULL
        thin = -(-turn // (t.MOST - FULL))
        coarse = np.arange(turn % thin, turn + 1, thin)
        kept = np.concatenate([coarse, np.arange(turn + 1, count)])
        steps = ((len(coarse), thin * period_s), (count - turn - 1, period_s))
    values = trace.torque_nm if kind == t.TORQUE else trace.angle_deg - trace.angle_deg[kept[0]]
    time_s = trace.time_s[kept] - trace.time_s[kept[0]]
    return t.curve(t.Curve(record.result.number, record.result.stamp, kind, time_s, values[kept]), steps, order)
