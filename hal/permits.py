"""Which motion may begin or go on: pure rules over what the devices read back. What is unknown counts as wrong.

Every motion needs a homed axis and closed safety inputs. Beyond that, each axis has its own rules, so that no part,
gun or camera can meet another: see `motion_refusal`. Motion away from trouble (jack down, guns back) needs least.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

from hal.interfaces import AxisState, ChuckState, ParkState, SafetyState

AxisName = Literal["stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed"]
AXES: tuple[AxisName, ...] = get_args(AxisName)
Target = float | Literal["home"]


@dataclass(frozen=True, slots=True)
class PermitLimits:
    """The cell's collision envelope.

    `view_safe_mm`: the camera may stand in a view only while the jack is at or below this height.
    `free_mm`: stage and table may move only while the jack is at or below it (studs out of the holes).
    `guns_back_mm`: the guns are back while their feed is at or below it.
    `pressure_low_bar`: below it the chuck does not hold.
    `read_s`: a device that has not answered by then is unknown.
    """

    view_safe_mm: float
    free_mm: float
    guns_back_mm: float
    pressure_low_bar: float
    read_s: float = 0.25


@dataclass(frozen=True, slots=True)
class Readings:
    """What the devices read back just now; None where a device gave no answer (or was not asked).

    `guarded`: the force guard is armed.
    """

    axis: AxisState | None = None
    safety: SafetyState | None = None
    chuck: ChuckState | None = None
    camera: ParkState | None = None
    jack: AxisState | None = None
    gun_feed: AxisState | None = None
    gun_table: AxisState | None = None
    guarded: bool = False


NEEDED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "jack": ("safety", "chuck", "camera_park", "gun_feed"),
        "stage_x": ("safety", "chuck", "camera_park", "gun_feed", "jack"),
        "stage_y": ("safety", "chuck", "camera_park", "gun_feed", "jack"),
        "shaft_table": ("safety", "chuck", "camera_park", "gun_feed", "jack"),
        "gun_table": ("safety", "gun_feed"),
        "gun_feed": ("safety", "jack", "gun_table"),
        "camera_park": ("safety", "jack"),
    }
)
"""Devices to be read, besides the moving one itself, before a motion is judged."""


def motion_refusal(axis: AxisName, target: Target, readings: Readings, limits: PermitLimits) -> str | None:
    """Why `axis` may not move to `target` (its unit, or "home"), in one sentence; None where it may."""
    if open_input := safety_refusal(readings.safety):
        return open_input
    if readings.axis is None:
        return f"{axis} does not say where it is"
    if target != "home" and not readings.axis.homed:
        return f"{axis} is not homed"
    match axis:
        case "jack":
            return _jack(target, readings.axis, readings, limits)
        case "stage_x" | "stage_y" | "shaft_table":
            return _below(target, readings, limits)
        case "gun_table":
            return _guns_back(readings, limits)
        case "gun_feed":
            return _feed(target, readings.axis, readings)


def camera_refusal(target: str, readings: Readings, limits: PermitLimits) -> str | None:
    """Why the camera arm may not swing to `target`; None where it may."""
    if open_input := safety_refusal(readings.safety):
        return open_input
    jack = readings.jack
    if jack is None or jack.moving:
        return "the jack moves, or does not say where it is"
    if target != "parked":
        if not jack.homed:
            return "the jack is not homed"
        if not jack.position <= limits.view_safe_mm:
            return f"the jack is at {jack.position:.1f} mm, above {limits.view_safe_mm:g} mm: in the camera's way"
    return None


def safety_refusal(state: SafetyState | None) -> str | None:
    """Which safety input is open or unknown; None where all are closed."""
    if state is None:
        return "the safety inputs give no answer, which counts as tripped"
    inputs = {
        "emergency stop": state.estop_released,
        "guard doors": state.guards_closed,
        "safe torque off": state.sto_released,
        "bench lock": state.bench_locked,
        "bench at its place": None if state.bench_moved is None else not state.bench_moved,
    }
    wrong = [f"{name} {'unknown' if value is None else 'open'}" for name, value in inputs.items() if value is not True]
    return f"safety: {', '.join(wrong)}" if wrong else None


def _jack(target: Target, state: AxisState, readings: Readings, limits: PermitLimits) -> str | None:
    if back := _guns_back(readings, limits):
        return back
    if target == "home" or target <= state.position:
        return None
    if chuck := _clamped(readings, limits):
        return chuck
    parked = readings.camera is not None and readings.camera.position == "parked"
    if not parked and not target <= limits.view_safe_mm:
        return f"the camera is not proven parked, the jack may not rise above {limits.view_safe_mm:g} mm"
    if not readings.guarded and not target <= limits.free_mm:
        return f"the force guard is not armed, the jack may not rise above {limits.free_mm:g} mm"
    return None


def _below(target: Target, readings: Readings, limits: PermitLimits) -> str | None:
    jack = readings.jack
    if jack is None or not jack.homed or not jack.position <= limits.free_mm:
        return f"the jack is not proven at or below {limits.free_mm:g} mm, where the studs are out of the holes"
    if readings.camera is None or readings.camera.position is None:
        return "the camera arm does not say where it is"
    if back := _guns_back(readings, limits):
        return back
    return None if target == "home" else _clamped(readings, limits)


def _feed(target: Target, state: AxisState, readings: Readings) -> str | None:
    if target == "home" or target <= state.position:
        return None
    if readings.jack is None or readings.jack.moving:
        return "the jack moves, or does not say that it stands"
    table = readings.gun_table
    if table is None or table.moving or not table.homed:
        return "the gun table is not proven homed and standing"
    return None


def _guns_back(readings: Readings, limits: PermitLimits) -> str | None:
    feed = readings.gun_feed
    if feed is None or not feed.homed or not feed.position <= limits.guns_back_mm:
        return f"the guns are not proven back (gun feed at or below {limits.guns_back_mm:g} mm)"
    return None


def _clamped(readings: Readings, limits: PermitLimits) -> str | None:
    chuck = readings.chuck
    if chuck is None or not (chuck.clamped_1 and chuck.clamped_2):
        return "the chuck is not proven clamped by both feedbacks"
    if not chuck.pressure_bar >= limits.pressure_low_bar:
        return f"the chuck's pressure is {chuck.pressure_bar:.1f} bar (limit {limits.pressure_low_bar:g} bar)"
    return None
