"""One Protocol per kind of device, and the readings they give.

Rules that hold for every device, fake or real:

* ``connect`` proves the identity of the device; ``close`` never raises.
* ``halt`` stops what the device is doing and returns only when the device has acknowledged it. It has no
  default: a device that cannot be stopped says so by raising.
* ``safe`` reads back whether the device is in its safe state; it never assumes.
* ``rearm`` makes every set-point the measured value, so that an old target is never resumed.
* A command returns when the device reports it done, with what was read back. It raises a `hal.errors.DeviceError`
  otherwise. Every exchange has a deadline of its own inside the backend.
* Times (``time_s``) are the event loop's monotonic seconds.
"""

from __future__ import annotations

from hal.interfaces.axes import Axis, AxisLimits, AxisState
from hal.interfaces.base import Device, Identity, Quality, Reading, SafeState
from hal.interfaces.force import ForceBlock, ForceGuard, ForceSensor, GuardLimits, GuardState
from hal.interfaces.heat import Heater, HeaterState, Thermometer
from hal.interfaces.io import (
    CameraPark,
    Chuck,
    ChuckState,
    GapProbe,
    NutFeeder,
    ParkState,
    PartStation,
    SafetyInputs,
    SafetyState,
)
from hal.interfaces.scanner import Frame, Scanner, View
from hal.interfaces.tightening import (
    Band,
    EnableOutput,
    EnableState,
    Gun,
    TighteningProgram,
    TighteningResult,
    ToolEnable,
    Trace,
    TurnResult,
)

__all__ = [
    "Axis",
    "AxisLimits",
    "AxisState",
    "Band",
    "CameraPark",
    "Chuck",
    "ChuckState",
    "Device",
    "EnableOutput",
    "EnableState",
    "ForceBlock",
    "ForceGuard",
    "ForceSensor",
    "Frame",
    "GapProbe",
    "GuardLimits",
    "GuardState",
    "Gun",
    "Heater",
    "HeaterState",
    "Identity",
    "NutFeeder",
    "ParkState",
    "PartStation",
    "Quality",
    "Reading",
    "SafeState",
    "SafetyInputs",
    "SafetyState",
    "Scanner",
    "Thermometer",
    "TighteningProgram",
    "TighteningResult",
    "ToolEnable",
    "Trace",
    "TurnResult",
    "View",
]
