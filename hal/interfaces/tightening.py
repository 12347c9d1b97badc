"""Tightening guns, their programs and results, and the output that lets them turn."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.interfaces.base import Device


class Band(StrEnum):
    """Where a value lies against its window."""

    LOW = "low"
    OK = "ok"
    HIGH = "high"


@dataclass(frozen=True, slots=True)
class TighteningProgram:
    """What a gun is asked to do to one joint. Angles in degrees from the threshold torque on; torques in N m."""

    stage: str
    target_torque_nm: float
    torque_low_nm: float
    torque_high_nm: float
    angle_low_deg: float
    angle_high_deg: float
    threshold_torque_nm: float
    speed_rpm: float
    timeout_s: float
    direction: Literal["tighten", "loosen"] = "tighten"


@dataclass(frozen=True, slots=True)
class Trace:
    """Torque over angle over time, equal lengths (n,), time from 0."""

    time_s: NDArray[np.float64]
    angle_deg: NDArray[np.float64]
    torque_nm: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TighteningResult:
    """What the gun's controller recorded. A joint counts once: by `controller_serial` and `tightening_id`."""

    key: str
    controller_serial: str
    tightening_id: int
    ok: bool
    torque_nm: float
    angle_deg: float
    torque_band: Band
    angle_band: Band
    trace: Trace
    time_s: float


@dataclass(frozen=True, slots=True)
class TurnResult:
    """A slow turn without tightening: how far the socket came and the largest torque met."""

    angle_deg: float
    peak_torque_nm: float
    time_s: float


class Gun(Device, Protocol):
    """A tightening spindle with its controller."""

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        """Turn the socket by `angle_deg` (positive tightens); stop early at `torque_limit_nm`."""
        ...

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        """Run `program` once; `key` is stored with the result. A key that was run before is refused, never rerun.

        Raises UnknownOutcome when the program may have run but no result came.
        """
        ...

    async def result(self, key: str) -> TighteningResult | None:
        """The stored result of `key`; None when the controller has none: then `key` was never run to its end."""
        ...


@dataclass(frozen=True, slots=True)
class EnableState:
    """Whether the guns may turn; `reason` says why they may not, for the operator."""

    enabled: bool
    reason: str
    time_s: float


class ToolEnable(Device, Protocol):
    """What lets both guns turn. On from `rearm` on while all is well: a trip of the guard takes it until it is cleared;
    halted, or dropped by its coupler, whose watchdog hears neither guard nor controller, it stays off until re-armed.

    A tightening goes on when the link to its controller is lost: this is what stops it then.
    """

    async def read(self) -> EnableState: ...


class EnableOutput(ToolEnable, Protocol):
    """The bare output, off until it is asked for; `rearm` leaves it off."""

    async def allow(self) -> None:
        """Set the output; where it is set, prove it and feed its watchdog.

        Raises DeviceFault where it has been dropped meanwhile, SafetyOpen where it has no power.
        """
        ...
