"""A whole cell of small devices, behind the real latch, rules and guard."""

from __future__ import annotations

from typing import Any, cast

from hal.cell import Cell
from hal.entries import Devices
from hal.guard.inloop import InLoopGuard
from hal.interfaces import Axis
from hal.interlocks import Permits
from hal.latch import Latch
from hal.permits import AxisName, PermitLimits
from hal.permitted import PermittedAxis, PermittedCameraPark, PermittedChuck
from tests.hal.small import SmallAxis, SmallChuck, SmallDevice, SmallForce, SmallPark, SmallSafety, SmallToolEnable

NAMES: tuple[AxisName, ...] = ("stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed")
LIMITS = PermitLimits(view_safe_mm=20.0, free_mm=360.0, guns_back_mm=1.0, pressure_low_bar=4.0)


class SmallCell:
    """`cell` is the cell, `bare` its small devices by name."""

    def __init__(self) -> None:
        self.axes = {name: SmallAxis(name) for name in NAMES}
        self.force, self.chuck, self.park, self.safety = SmallForce(), SmallChuck(), SmallPark(), SmallSafety()
        self.tool_enable = SmallToolEnable()
        self.bare: dict[str, SmallDevice] = {
            **{name: SmallDevice(name) for name in Devices.model_fields},
            **self.axes,
            "jack_force": self.force,
            "chuck": self.chuck,
            "camera_park": self.park,
            "safety": self.safety,
            "tool_enable": self.tool_enable,
        }
        self.latch = Latch()
        self.guard = InLoopGuard(
            self.force, list(self.axes.values()), self.latch, idle_block=500, idle_stale_s=0.05, halt_deadline_s=0.1
        )
        axes: dict[AxisName, Axis] = {**self.axes}
        looked_at = (self.chuck, self.park, self.safety, self.tool_enable)
        permits = Permits(axes, *looked_at, self.guard, LIMITS, self.latch)
        permitted: dict[str, Any] = {name: PermittedAxis(name, self.axes[name], permits, 0.02) for name in NAMES}
        permitted["camera_park"] = PermittedCameraPark(self.park, permits)
        permitted["chuck"] = PermittedChuck(self.chuck, permits)
        self.cell = Cell(guard=self.guard, latch=self.latch, **cast(dict[str, Any], {**self.bare, **permitted}))
