"""What the steps of a calibration are given, and the few things that they do: present, move, look.

Devices act behind the cell's own latch and motion rules, and the jack rises under the force guard, as in a run.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellctl.calibrating.camera import require_millimetres
from cellctl.calibration import Calibration
from cellctl.kinematics import AxesPosition
from cellctl.ports import Devices, Interlock
from cellctl.steps.motion import AXES, AxisName, axis, shaft_axes
from cellctl.vision.part import Refused
from hal.config import Delays
from hal.interfaces import Frame, GuardLimits, View
from hal.jobs import Jobs

NOTHING = "-"
"""Serial number of no part at all."""
VISION_S = 0.8
"""Cell time that a measurement is charged under virtual time."""
TOUCH_N = 60.0
"""Change of the force by which the guard stops a jack that should touch nothing."""


@dataclass(frozen=True, slots=True)
class Stand:
    """One cell, connected, and where its clouds are measured. `tell` says to a person what is under way.

    `rotor` and `shaft` are the serial numbers of the parts that are used where parts are needed; stage and table may
    move while the jack is at or below `free_mm`.
    """

    devices: Devices
    interlock: Interlock
    jobs: Jobs
    calibration: Calibration
    guard: Delays
    tell: Callable[[str], None]
    rotor: str
    shaft: str
    free_mm: float


async def prepare(stand: Stand) -> None:
    """Everything at its start. Raises DeviceError, SafetyError."""
    for name in AXES:
        if not (await axis(stand.devices, name).read()).homed:
            await axis(stand.devices, name).home()
    await move(stand, "gun_feed", 0.0)
    await move(stand, "jack", 0.0)
    await camera_to(stand, "parked")


async def present(stand: Stand, rotor: str, shaft: str) -> None:
    """Ask for what goes into the cell, by serial numbers, and clamp it. Raises Refused where others are read."""
    stand.tell(f"please present: rotor {rotor}, in the chuck {shaft}")
    read = await stand.devices.part_station.present(rotor, shaft)
    if tuple(read) != (rotor, shaft):
        raise Refused("wrong_part", f"{read[0]} and {read[1]} were read, asked for were {rotor} and {shaft}")
    state = await stand.devices.chuck.clamp()
    if not (state.clamped_1 and state.clamped_2):
        raise Refused("chuck_not_clamped", "the chuck's two feedbacks do not both say clamped")


async def move(stand: Stand, name: AxisName, position: float) -> None:
    """Move one axis to `position` (mm or deg) at its own speed."""
    device = axis(stand.devices, name)
    await device.move_to(position, speed=device.limits.max_speed)


async def camera_to(stand: Stand, place: Literal["parked", "rotor", "shaft"]) -> None:
    """Bring the camera's arm to `place`, unless it is there."""
    arm = stand.devices.camera_park
    if (await arm.read()).position != place:
        await arm.go(place)


async def capture(stand: Stand, view: View) -> Frame:
    """A frame of this very view, taken after the command, in millimetres. Raises Refused."""
    asked_s = asyncio.get_running_loop().time()
    frame = await stand.devices.scanner.capture(view)
    if frame.view != view or frame.time_s < asked_s:
        raise Refused("old_frame", f"the scanner gave frame {frame.frame_id} of view {frame.view}, asked for {view}")
    require_millimetres(frame.points_mm)
    return frame


async def where(stand: Stand) -> AxesPosition:
    """Where the four shaft axes stand."""
    return await shaft_axes(stand.devices)


async def guarded_jack(stand: Stand, position_mm: float) -> None:
    """Move the jack under the force guard: it should touch nothing. Raises GuardTripped."""
    block = await stand.interlock.window(0.2)
    plan = stand.guard
    limits = GuardLimits(
        "calibrate", float(np.mean(block.samples_n)), TOUCH_N, -TOUCH_N, plan.stale_ms, plan.contact_block
    )
    await stand.interlock.arm(limits)
    try:
        await move(stand, "jack", position_mm)
    finally:
        await stand.interlock.disarm()
