"""Commands to axes, camera arm and chuck, each through the ledger."""

from __future__ import annotations

import math
from typing import Literal

from cellctl.kinematics import AxesPosition
from cellctl.ports import Devices, RunContext, RunHeld
from hal.interfaces import Axis, AxisState, ParkState

AxisName = Literal["stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed"]
AXES: tuple[AxisName, ...] = ("gun_feed", "gun_table", "jack", "stage_x", "stage_y", "shaft_table")
IN_THE_WAY: tuple[AxisName, ...] = ("gun_feed", "jack")
"""Homed first, one after the other: they could be in the way of the others."""


def axis(devices: Devices, name: AxisName) -> Axis:
    """The axis of that name."""
    found: Axis = getattr(devices, name)
    return found


async def move(run: RunContext, name: AxisName, position: float, *, speed: float | None = None) -> AxisState:
    """Move one axis to `position` (mm or deg); `speed` per second, the axis' own limit where it is not given."""
    device = axis(run.devices, name)
    speed = device.limits.max_speed if speed is None else min(speed, device.limits.max_speed)
    return await run.ledger.act(
        name, "move_to", {"position": position, "speed": speed}, lambda key: device.move_to(position, speed=speed)
    )


async def home(run: RunContext, name: AxisName) -> AxisState:
    """Home one axis unless it is homed."""
    device = axis(run.devices, name)
    state = await device.read()
    if state.homed:
        return state
    return await run.ledger.act(name, "home", {}, lambda key: device.home())


async def camera_to(run: RunContext, position: Literal["parked", "rotor", "shaft"]) -> ParkState:
    """Bring the camera arm to `position`, proven by its feedbacks."""
    arm = run.devices.camera_park
    state = await arm.read()
    if state.position == position:
        return state
    state = await run.ledger.act("camera_park", "go", {"position": position}, lambda key: arm.go(position))
    if state.position != position:
        raise RunHeld("camera_not_in_place", f"the camera arm does not report {position}")
    return state


async def shaft_axes(devices: Devices) -> AxesPosition:
    """Where the four shaft axes stand, as their encoders say."""
    values = [(await axis(devices, name).read()).position for name in ("stage_x", "stage_y", "jack", "shaft_table")]
    if not all(math.isfinite(value) for value in values):
        raise RunHeld("axis_position_unknown", "an axis of the shaft gives no finite position")
    return AxesPosition(x_mm=values[0], y_mm=values[1], z_mm=values[2], theta_deg=values[3])


async def require_clamped(run: RunContext) -> None:
    """Raises RunHeld unless both feedbacks of the chuck say clamped."""
    state = await run.devices.chuck.read()
    if not (state.clamped_1 and state.clamped_2):
        raise RunHeld("chuck_not_clamped", "the chuck's two feedbacks do not both say clamped")


async def require_safety(run: RunContext) -> None:
    """Raises RunHeld unless every safety input is known and closed."""
    state = await run.devices.safety.read()
    if not state.ok:
        raise RunHeld("safety_open", f"a safety input is open or unknown: {state}")
