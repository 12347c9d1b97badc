"""What the steps of a calibration are given, and the few things that they do: move, look, weigh, read the probes.

Devices act behind the cell's own latch and motion rules, and the jack rises under the force guard, as in a run.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellctl.calibrating.camera import require_millimetres
from cellctl.calibrating.force import Weighed
from cellctl.calibration import Calibration
from cellctl.kinematics import AxesPosition
from cellctl.ports import Devices, Interlock
from cellctl.steps.motion import AXES, AxisName, axis, shaft_axes
from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused
from hal.config import Delays
from hal.interfaces import Frame, GapProbe, GuardLimits, Quality, View
from hal.jobs import Jobs

TOUCH_N = 60.0
"""Change of the force by which the guard stops a jack that should touch nothing."""
SETTLE_S = 2.0
WEIGH_S = 1.0
PROBE_READS, PROBE_S = 16, 0.05


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


async def weigh(stand: Stand, mass_kg: float, at_mm: float) -> Weighed:
    """Readings at height `at_mm`, arrived at from below and from above."""
    await move(stand, "jack", at_mm)
    up = await _reading(stand)
    await move(stand, "jack", 2.0 * at_mm)
    await move(stand, "jack", at_mm)
    down = await _reading(stand)
    noise = float(np.sqrt(0.5 * (np.var(up, ddof=1) + np.var(down, ddof=1))))
    return Weighed(mass_kg, float(np.mean(up)), float(np.mean(down)), noise)


async def _reading(stand: Stand) -> Array:
    await asyncio.sleep(SETTLE_S)
    return (await stand.interlock.window(WEIGH_S)).samples_n


async def probes(stand: Stand) -> Array:
    """(3,) means of several readings of the gap probes, mm. Raises Refused where one does not measure."""
    await asyncio.sleep(SETTLE_S)
    devices: tuple[GapProbe, ...] = (stand.devices.gap_probe_1, stand.devices.gap_probe_2, stand.devices.gap_probe_3)
    read = []
    for _ in range(PROBE_READS):
        for probe in devices:
            reading = await probe.read()
            if reading.quality is not Quality.GOOD:
                at = (await where(stand)).z_mm
                raise Refused(
                    "out_of_range",
                    f"{probe.name} says {reading.value:g} mm ({reading.quality.value}) with the jack at {at:.0f} mm: "
                    "set the probes nearer, or centre the mandrel",
                )
            read.append(reading.value)
        await asyncio.sleep(PROBE_S)
    return np.asarray(np.array(read).reshape(-1, len(devices)).mean(axis=0))
