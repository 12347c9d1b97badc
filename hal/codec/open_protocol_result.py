"""Open Protocol: results of tightenings, MID 0061 (last) and MID 0065 (old, by its number)."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from hal.codec.open_protocol import Layout, Message, read_fields, write_fields
from hal.codec.open_protocol_messages import OLD_RESULT, RESULT


@dataclass(frozen=True, slots=True)
class Result:
    """One tightening as the controller recorded it.

    `identifier` is what MID 0050 gave; torque and angle status are 0 low, 1 in the window, 2 high; limits are those of
    the parameter set (zero in MID 0065, which does not tell them). `number` is the controller's tightening ID.
    """

    number: int
    identifier: str
    parameter_set: int
    ok: bool
    torque_status: int
    angle_status: int
    torque_nm: float
    angle_deg: int
    stamp: str
    cell: int = 0
    channel: int = 0
    controller: str = ""
    job: int = 0
    batch_size: int = 0
    batch_counter: int = 0
    batch_status: int = 0
    torque_low_nm: float = 0.0
    torque_high_nm: float = 0.0
    target_torque_nm: float = 0.0
    angle_low_deg: int = 0
    angle_high_deg: int = 0
    target_angle_deg: int = 0
    changed: str = ""


_HEAD: Layout = (("cell", 4, "int"), ("channel", 2, "int"), ("controller", 25, "text"), ("identifier", 25, "text"))
_VALUES: Layout = (
    ("torque_low_nm", 6, "nm"),
    ("torque_high_nm", 6, "nm"),
    ("target_torque_nm", 6, "nm"),
    ("torque_nm", 6, "nm"),
    ("angle_low_deg", 5, "int"),
    ("angle_high_deg", 5, "int"),
    ("target_angle_deg", 5, "int"),
    ("angle_deg", 5, "int"),
)
_REVISION_1: Layout = (
    *_HEAD,
    ("job", 2, "int"),
    ("parameter_set", 3, "int"),
    ("batch_size", 4, "int"),
    ("batch_counter", 4, "int"),
    ("ok", 1, "flag"),
    ("torque_status", 1, "int"),
    ("angle_status", 1, "int"),
    *_VALUES,
    ("stamp", 19, "text"),
    ("changed", 19, "text"),
    ("batch_status", 1, "int"),
    ("number", 10, "int"),
)
_REVISION_2: Layout = (
    *_HEAD,
    ("job", 4, "int"),
    ("parameter_set", 3, "int"),
    ("", 2, "skip"),  # strategy
    ("", 5, "skip"),  # strategy options
    ("batch_size", 4, "int"),
    ("batch_counter", 4, "int"),
    ("ok", 1, "flag"),
    ("batch_status", 1, "int"),
    ("torque_status", 1, "int"),
    ("angle_status", 1, "int"),
    *((("", 1, "skip"),) * 5),  # rundown angle, current, self-tap, prevail monitoring and compensation
    ("", 10, "skip"),  # error bits
    *_VALUES,
    *((("", 5, "skip"),) * 3),  # rundown angle
    *((("", 3, "skip"),) * 3),  # current
    *((("", 6, "skip"),) * 6),  # self-tap and prevailing torque
    ("number", 10, "int"),
    ("", 5, "skip"),  # job sequence
    ("", 5, "skip"),  # sync tightening
    ("", 14, "skip"),  # tool serial
    ("stamp", 19, "text"),
    ("changed", 19, "text"),
)
"""Later revisions append fields."""
_OLD: Layout = (
    ("number", 10, "int"),
    ("identifier", 25, "text"),
    ("parameter_set", 3, "int"),
    ("batch_counter", 4, "int"),
    ("ok", 1, "flag"),
    ("torque_status", 1, "int"),
    ("angle_status", 1, "int"),
    ("torque_nm", 6, "nm"),
    ("angle_deg", 5, "int"),
    ("stamp", 19, "text"),
    ("batch_status", 1, "int"),
)


def read_result(message: Message) -> Result:
    """MID 0061 of any revision but 998 and 999, or MID 0065 of revision 1."""
    if message.mid == OLD_RESULT:
        return Result(**read_fields(message, _OLD))
    return Result(**read_fields(message, _REVISION_1 if message.revision == 1 else _REVISION_2))


def result(value: Result, revision: int) -> Message:
    """MID 0061 of revision 1 or 2."""
    layout = _REVISION_1 if revision == 1 else _REVISION_2
    return Message(RESULT, write_fields(asdict(value), layout, "MID 0061"), revision)


def old_result(value: Result) -> Message:
    """MID 0065 of revision 1."""
    return Message(OLD_RESULT, write_fields(asdict(value), _OLD, "MID 0065"))
