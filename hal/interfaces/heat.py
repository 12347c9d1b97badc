"""Thermometers and the heater."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hal.interfaces.base import Device, Reading


class Thermometer(Device, Protocol):
    """One temperature channel, degrees Celsius."""

    async def read(self) -> Reading: ...


@dataclass(frozen=True, slots=True)
class HeaterState:
    """Read-back of the heater controller."""

    setpoint_c: float
    power_w: float
    on: bool
    watchdog_armed: bool
    alarm: str
    time_s: float


class Heater(Device, Protocol):
    """A heater controller that regulates the spigot's temperature itself and trips off-line on a lost link."""

    @property
    def max_power_w(self) -> float: ...
    async def read(self) -> HeaterState: ...
    async def heat(self, setpoint_c: float, *, ramp_k_per_min: float, max_power_w: float) -> HeaterState:
        """Regulate to `setpoint_c`, the set-point rising no faster than the ramp. Returns once read back."""
        ...

    async def off(self) -> HeaterState: ...
