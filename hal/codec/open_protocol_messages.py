"""Open Protocol: the messages that a tightening cell needs, as frozen values. Layouts: chapter 5 of the specification.

Torques in newton metre (hundredths on the wire), angles in whole degrees.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from hal.codec.open_protocol import Layout, Message, OpenProtocolError, read_fields, write_fields

# Messages that are a header, or a header and a number.
START, STARTED, STOP, REFUSED, ACCEPTED, REQUEST, SUBSCRIBE = 1, 2, 3, 4, 5, 6, 8
SET_IDS_ASK, SET_IDS, SET_ASK, SET_DATA = 10, 11, 12, 13
SELECTED_SUBSCRIBE, SELECTED, SELECTED_ACK, SELECTED_UNSUBSCRIBE, SELECT = 14, 15, 16, 17, 18
TOOL_ASK, TOOL_DATA, DISABLE, ENABLE, IDENTIFIER = 40, 41, 42, 43, 50
RESULT_SUBSCRIBE, RESULT, RESULT_ACK, RESULT_UNSUBSCRIBE, OLD_RESULT_ASK, OLD_RESULT = 60, 61, 62, 63, 64, 65
ALARM_SUBSCRIBE, ALARM, ALARM_ACK, ALARM_UNSUBSCRIBE, ALARM_GONE, ALARM_GONE_ACK = 70, 71, 72, 73, 74, 75
ALARM_STATUS, ALARM_STATUS_ACK, ALARM_CLEAR = 76, 77, 78
RELAY_SUBSCRIBE, RELAY, RELAY_ACK = 216, 217, 218
INPUT_SET, INPUT_RESET = 224, 225
TRACE, KEEP_ALIVE = 900, 9999

ANSWERS = {
    STARTED: START,
    SET_IDS: SET_IDS_ASK,
    SET_DATA: SET_ASK,
    TOOL_DATA: TOOL_ASK,
    OLD_RESULT: OLD_RESULT_ASK,
    KEEP_ALIVE: KEEP_ALIVE,
}
"""Which request each answer belongs to, beside the 0004 and 0005 that name theirs."""

ERRORS = {
    1: "invalid data",
    2: "parameter set not present",
    3: "parameter set cannot be set",
    4: "parameter set not running",
    8: "identifier source not granted",
    9: "result subscription exists already",
    11: "alarm subscription exists already",
    13: "parameter set subscription exists already",
    15: "tightening not found",
    27: "tool is inaccessible",
    59: "tool currently in use",
    71: "subscription exists already",
    73: "subscribed MID unsupported",
    74: "subscribed MID revision unsupported",
    75: "requested MID unsupported",
    79: "command failed",
    84: "relay subscription exists already",
    92: "commands disabled",
    96: "client already connected",
    97: "MID revision unsupported",
    98: "controller's internal time-out",
    99: "unknown MID",
    101: "tightening in progress",
}
"""Codes of MID 0004 that this cell can meet."""
SUBSCRIBED_ALREADY = frozenset({9, 11, 13, 71, 84})
NOT_FOUND, CLIENT_CONNECTED, REVISION_UNSUPPORTED = 15, 96, 97


@dataclass(frozen=True, slots=True)
class Started:
    """MID 0002. Fields beyond the message's revision are empty."""

    cell: int = 0
    channel: int = 0
    controller: str = ""
    supplier: str = ""
    protocol: str = ""
    firmware: str = ""
    tool_firmware: str = ""
    unit_type: str = ""
    serial: str = ""


_STARTED: Layout = (
    ("cell", 4, "int"),
    ("channel", 2, "int"),
    ("controller", 25, "text"),
    ("supplier", 3, "text"),
    ("protocol", 19, "text"),
    ("firmware", 19, "text"),
    ("tool_firmware", 19, "text"),
    ("unit_type", 24, "text"),
    ("serial", 10, "text"),
)
_STARTED_COUNT = {1: 3, 2: 4, 3: 7}
"""Fields by revision; from 4 on all of them, and more that are ignored."""


def read_started(message: Message) -> Started:
    """MID 0002 of any revision."""
    return Started(**read_fields(message, _STARTED[: _STARTED_COUNT.get(message.revision, len(_STARTED))]))


def started(value: Started, revision: int) -> Message:
    """MID 0002 of revision 1 to 4."""
    layout = _STARTED[: _STARTED_COUNT.get(revision, len(_STARTED))]
    return Message(STARTED, write_fields(asdict(value), layout, "MID 0002"), revision)


def read_refused(message: Message) -> tuple[int, int]:
    """(MID that was refused, error code) of MID 0004."""
    values = read_fields(message, (("mid", 4, "int"), ("code", 2, "int")), numbered=False)
    return values["mid"], values["code"]


def refused(mid: int, code: int) -> Message:
    """MID 0004."""
    return Message(REFUSED, b"%04d%02d" % (mid, code))


def read_number(message: Message, width: int) -> int:
    """The one number of a message that carries nothing else before it: 0005, 0012, 0018, 0064, 0074, 0224."""
    return int(read_fields(message, (("number", width, "int"),), numbered=False)["number"])


def numbered(mid: int, number: int, width: int) -> Message:
    """A message that carries one number of `width` digits."""
    return Message(mid, write_fields({"number": number}, (("number", width, "int"),), f"MID {mid:04d}", numbered=False))


def read_set_ids(message: Message) -> tuple[int, ...]:
    """Numbers of the parameter sets of MID 0011."""
    count = read_number(message, 3)
    layout: Layout = (("count", 3, "int"), *((f"id {i + 1}", 3, "int") for i in range(count)))
    return tuple(read_fields(message, layout, numbered=False).values())[1:]


def set_ids(ids: tuple[int, ...]) -> Message:
    """MID 0011."""
    return Message(SET_IDS, b"%03d" % len(ids) + b"".join(b"%03d" % number for number in ids))


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """MID 0013: what the controller tells of one parameter set. `direction` is 1 clockwise, 2 counter-clockwise."""

    number: int
    name: str
    direction: int
    batch: int
    torque_low_nm: float
    torque_high_nm: float
    torque_nm: float
    angle_low_deg: int
    angle_high_deg: int
    angle_deg: int


_SET: Layout = (
    ("number", 3, "int"),
    ("name", 25, "text"),
    ("direction", 1, "int"),
    ("batch", 2, "int"),
    ("torque_low_nm", 6, "nm"),
    ("torque_high_nm", 6, "nm"),
    ("torque_nm", 6, "nm"),
    ("angle_low_deg", 5, "int"),
    ("angle_high_deg", 5, "int"),
    ("angle_deg", 5, "int"),
)


def read_set(message: Message) -> ParameterSet:
    """MID 0013."""
    return ParameterSet(**read_fields(message, _SET))


def set_data(value: ParameterSet) -> Message:
    """MID 0013 of revision 1."""
    return Message(SET_DATA, write_fields(asdict(value), _SET, "MID 0013"))


def told_set(
    stage: str,
    speed_rpm: float,
    direction: int,
    torque_nm: tuple[float, float, float],
    angle_deg: tuple[float, float, float],
) -> ParameterSet:
    """What a controller tells of a set for this: (low, high, target) of torque and angle, rounded as on the wire.

    The protocol tells no speed: by convention it stands in the name, as in ``final 10 rpm``. Number and batch are 0.
    """
    low, high, target = (round(value * 100.0) / 100.0 for value in torque_nm)
    angles = [round(value) for value in angle_deg]
    return ParameterSet(0, f"{stage} {speed_rpm:g} rpm", direction, 0, low, high, target, *angles)


_SELECTED: Layout = (("number", 3, "int"), ("changed", 19, "text"))


def read_selected(message: Message) -> tuple[int, str]:
    """(parameter set, time of its last change) of MID 0015; 0 where none is selected."""
    if message.revision > 1:
        return int(read_fields(message, _SELECTED[:1])["number"]), ""
    values = read_fields(message, _SELECTED, numbered=False)
    return values["number"], values["changed"]


def selected(number: int, changed: str) -> Message:
    """MID 0015 of revision 1."""
    values = {"number": number, "changed": changed}
    return Message(SELECTED, write_fields(values, _SELECTED, "MID 0015", numbered=False))


_TOOL: Layout = (
    ("tool_serial", 14, "text"),
    ("tightenings", 10, "int"),
    ("calibrated", 19, "text"),
    ("serial", 10, "text"),
)


def read_tool(message: Message) -> tuple[str, str]:
    """(serial number of the tool, of the controller) of MID 0041."""
    values = read_fields(message, _TOOL)
    return values["tool_serial"], values["serial"]


def tool_data(tool_serial: str, serial: str, tightenings: int, calibrated: str) -> Message:
    """MID 0041 of revision 1."""
    values = {"tool_serial": tool_serial, "tightenings": tightenings, "calibrated": calibrated, "serial": serial}
    return Message(TOOL_DATA, write_fields(values, _TOOL, "MID 0041"))


@dataclass(frozen=True, slots=True)
class Alarm:
    """MID 0071 and 0076. `active` is false where there is none."""

    code: str
    controller_ready: bool
    tool_ready: bool
    stamp: str
    active: bool = True


_ALARM: Layout = (
    ("code", 4, "text"),
    ("controller_ready", 1, "flag"),
    ("tool_ready", 1, "flag"),
    ("stamp", 19, "text"),
)
_ALARM_STATUS: Layout = (("active", 1, "flag"), *_ALARM)


def read_alarm(message: Message) -> Alarm:
    """MID 0071 or 0076 of revision 1."""
    return Alarm(**read_fields(message, _ALARM if message.mid == ALARM else _ALARM_STATUS))


def alarm(value: Alarm) -> Message:
    """MID 0071 of revision 1."""
    return Message(ALARM, write_fields(asdict(value), _ALARM, "MID 0071"))


def alarm_status(value: Alarm) -> Message:
    """MID 0076 of revision 1."""
    return Message(ALARM_STATUS, write_fields(asdict(value), _ALARM_STATUS, "MID 0076"))


_RELAY: Layout = (("relay", 3, "int"), ("on", 1, "flag"))


def read_relay(message: Message) -> tuple[int, bool]:
    """(relay function, whether it is on) of MID 0217."""
    values = read_fields(message, _RELAY)
    return values["relay"], values["on"]


def relay(function: int, on: bool) -> Message:
    """MID 0217."""
    return Message(RELAY, write_fields({"relay": function, "on": on}, _RELAY, "MID 0217"))


def subscription(mid: int, revision: int, extra: bytes = b"", *, no_ack: bool = False) -> Message:
    """MID 0008: subscribe `mid` of `revision`."""
    return Message(SUBSCRIBE, b"%04d%03d%02d" % (mid, revision, len(extra)) + extra, no_ack=no_ack)


def request(mid: int, revision: int, extra: bytes = b"") -> Message:
    """MID 0006: ask for `mid` of `revision`."""
    return Message(REQUEST, b"%04d%03d%02d" % (mid, revision, len(extra)) + extra)


def read_subject(message: Message) -> tuple[int, int, bytes]:
    """(MID, revision, extra data) of MID 0006 and 0008."""
    layout: Layout = (("mid", 4, "int"), ("revision", 3, "int"), ("length", 2, "int"))
    values: dict[str, Any] = read_fields(message, layout, numbered=False)
    extra = message.data[9:]
    if len(extra) != values["length"]:
        raise OpenProtocolError(f"{message} extra data", f"{len(extra)} of {values['length']} bytes")
    return values["mid"], values["revision"], extra
