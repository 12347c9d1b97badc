"""Positioning axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from hal.interfaces.base import Device


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Travel, speed and acceleration limits in the axis' unit (mm or deg), per second."""

    low: float
    high: float
    max_speed: float
    max_acceleration: float


@dataclass(frozen=True, slots=True)
class AxisState:
    """Read-back of an axis: encoder position in mm or deg, velocity per second, and the drive's own flags."""

    position: float
    velocity: float
    homed: bool
    enabled: bool
    brake_closed: bool
    moving: bool
    time_s: float


class Axis(Device, Protocol):
    """A positioning axis (CiA 402 profile position). Positions are absolute, in `unit`."""

    @property
    def unit(self) -> Literal["mm", "deg"]: ...
    @property
    def limits(self) -> AxisLimits: ...
    async def home(self) -> AxisState: ...
    async def read(self) -> AxisState: ...
    async def move_to(self, position: float, *, speed: float) -> AxisState:
        """Move to `position` at no more than `speed`; return what the encoder reads once the axis stands.

        Raises DeviceRefused (not homed, outside limits), Interrupted (halted on the way), DeviceFault.
        """
        ...
