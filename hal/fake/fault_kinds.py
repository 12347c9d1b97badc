"""Which faults each device can be given, as data. Every (device, kind) pair here is acted out by that device's fake.

Any device can be

* ``gone``: every exchange fails at once (NotConnected);
* ``hung``: no exchange is answered (DeviceTimeout after the backend's deadline);
* ``late``: every answer comes ``value`` seconds late (DeviceTimeout where that is beyond the deadline).

Whatever gives a number can be ``nan``, ``stuck`` (at ``value``, or at the last good number), ``drift`` (``value`` units
per second), ``out_of_range`` (reads ``value``) or ``stale`` (the last good number with its old time).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Need = Literal["none", "optional", "needed", "joint"]
"""Whether a kind takes a value; ``joint`` is the 0-based number of a joint."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of fault: what its value means (`unit` of it) and one sentence on what happens."""

    value: Need
    unit: str
    text: str


def _kind(value: Need, unit: str, text: str) -> Kind:
    return Kind(value, unit, text)


_COMMON = {
    "gone": _kind("none", "", "the link is down"),
    "hung": _kind("none", "", "no exchange is answered"),
    "late": _kind("needed", "s", "every answer comes late"),
}
_READING = {
    "nan": _kind("none", "", "open circuit: not a number"),
    "stuck": _kind("optional", "reading", "the value no longer changes"),
    "drift": _kind("needed", "reading/s", "the value walks away"),
    "out_of_range": _kind("needed", "reading", "beyond the sensor's range"),
    "stale": _kind("none", "", "an old value with its old time"),
}
_AXIS = _COMMON | {
    "following_error": _kind("none", "", "the drive trips in motion and stands"),
    "home_lost": _kind("none", "", "the drive has lost its reference"),
    "stale_target": _kind("none", "", "target reached is reported without motion"),
}
_GUN = _COMMON | {
    "result_lost": _kind("none", "", "the program runs, its result never comes"),
    "result_repeated": _kind("none", "", "the previous result is answered again"),
    "gripped_nothing": _kind("none", "", "OK is reported with nothing in the socket"),
    "cross_thread": _kind("joint", "joint", "the nut jams askew on its first thread"),
    "slip_off": _kind("joint", "joint", "the socket slips off the nut"),
    "missing_washer": _kind("joint", "joint", "nothing under the nut"),
    "stripped_thread": _kind("joint", "joint", "the thread gives way"),
    "yielded_stud": _kind("joint", "joint", "the stud yields early"),
}
_FORCE = _COMMON | _READING | {"gap": _kind("none", "", "samples are missing from the stream")}
_PYROMETER = _COMMON | _READING | {"wrong_emissivity": _kind("needed", "1", "emissivity relative to the set one")}
_HEATER = _COMMON | {
    "stuck_on": _kind("none", "", "the power stage conducts whatever is asked"),
    "loop_break": _kind("none", "", "no current flows although power is asked"),
    "setpoint_not_taken": _kind("none", "", "the old set-point is read back"),
    "watchdog_trip": _kind("none", "", "the off-line watchdog tripped"),
    "over_temperature": _kind("none", "", "the controller's limit switch opened"),
}
_CHUCK = _COMMON | {
    "opening": _kind("none", "", "the jaws open"),
    "pressure_drop": _kind("needed", "bar", "the pressure falls to the value"),
    "both_unset": _kind("none", "", "neither feedback says clamped"),
    "disagree": _kind("none", "", "one feedback says clamped, the other does not"),
}
_PARK = _COMMON | {
    "stuck_between": _kind("none", "", "the arm stops on its way"),
    "disagree": _kind("none", "", "both end switches are set"),
}
_FEEDER = _COMMON | {
    "empty": _kind("none", "", "the magazine is empty"),
    "missing_nut": _kind("optional", "joint", "a load brings no nut"),
    "miscount": _kind("needed", "1", "the counter is off by the value"),
}
_ENABLE = _COMMON | {
    "dropped": _kind("none", "", "the coupler drops the output"),
    "not_taken": _kind("none", "", "the output does not switch on"),
}
_SAFETY = _COMMON | {
    "estop": _kind("none", "", "emergency stop pressed"),
    "guard_open": _kind("none", "", "a guard door is open"),
    "sto_open": _kind("none", "", "safe torque off is active"),
    "channels_disagree": _kind("none", "", "the two channels of the emergency stop disagree"),
    "bench_unlocked": _kind("none", "", "the bench lock is open"),
    "bench_moved": _kind("none", "", "the bench has moved since the calibration"),
}
_STATION = _COMMON | {
    "wrong_serial": _kind("none", "", "another shaft's serial number is read"),
    "unreadable": _kind("none", "", "the code cannot be read"),
}
_SCANNER = _COMMON | {
    "no_frame": _kind("none", "", "the capture gives no frame"),
    "half_frame": _kind("none", "", "the lower half of the frame is missing"),
    "all_invalid": _kind("none", "", "no pixel was measured"),
    "wrong_unit": _kind("none", "", "the cloud is in metres"),
    "old_frame": _kind("none", "", "the previous frame is delivered again"),
}

DEVICE_KINDS: Mapping[str, Mapping[str, Kind]] = MappingProxyType(
    dict.fromkeys(("stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed"), _AXIS)
    | dict.fromkeys(("gun_a", "gun_b"), _GUN)
    | dict.fromkeys(("jack_force", "gun_force_a", "gun_force_b"), _FORCE)
    | dict.fromkeys(("spigot_tc_1", "spigot_tc_2", "rotor_tc"), _COMMON | _READING)
    | {"pyrometer": _PYROMETER, "heater": _HEATER, "chuck": _CHUCK, "camera_park": _PARK, "nut_feeder": _FEEDER}
    | dict.fromkeys(("gap_probe_1", "gap_probe_2", "gap_probe_3"), _COMMON | _READING)
    | {"tool_enable": _ENABLE, "safety": _SAFETY, "part_station": _STATION, "scanner": _SCANNER}
)
"""Kinds by device, by the names of the cell file."""

PHASES = ("scan", "align", "jack_up", "heat", "tighten")
"""The phases that a fault can wait for."""
