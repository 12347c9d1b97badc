"""Which of the controller's CAN frames reach the drives. While latched, only those that cannot move anything.

What may pass is listed, everything else may not: network management short of a reset, reading, controlwords that
neither enable operation nor start anything, and the settings that a drive is given when it is connected. A transfer in
segments carries its object in its first message only, so none of its parts passes.
"""

from __future__ import annotations

from types import MappingProxyType

from hal.codec.cia301 import (
    CONSUMER_HEARTBEAT,
    ERROR_BEHAVIOUR,
    HEARTBEAT,
    NMT,
    ON_CHANGE,
    PDO_OFF,
    PRODUCER_HEARTBEAT,
    RPDO1,
    SDO_REQUEST,
    TPDO1,
    TPDO2,
    Malformed,
    NmtCommand,
    pdo_cob,
    pdo_mapping,
    unpack,
)
from hal.codec.cia402 import (
    ABORT_CONNECTION,
    ABORT_QUICK_STOP,
    CONTROLWORD,
    ENABLE,
    FAULT_QUICK_STOP,
    FAULT_REACTION,
    FOLLOWING_WINDOW,
    HOMING_ACCELERATION,
    HOMING_METHOD,
    HOMING_SPEED,
    HOMING_SPEED_ZERO,
    LAYOUTS,
    LIMIT_HIGH,
    LIMIT_LOW,
    MAX_MOTOR_SPEED,
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    QUICK_STOP_DECELERATION,
    QUICK_STOP_OPTION,
    START,
    STAY_IN_QUICK_STOP,
)
from hal.codec.lawicel import CanFrame

NODES = 0x7F
"""Node numbers are 1 to this."""
_NMT = (NmtCommand.START, NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL)
"""A reset is not among them: it takes the torque from an axis that may be hanging."""
_SETTINGS = frozenset(
    (entry.index, entry.sub)
    for entry in (
        CONSUMER_HEARTBEAT,
        PRODUCER_HEARTBEAT,
        ERROR_BEHAVIOUR,
        FOLLOWING_WINDOW,
        LIMIT_LOW,
        LIMIT_HIGH,
        PROFILE_ACCELERATION,
        PROFILE_DECELERATION,
        QUICK_STOP_DECELERATION,
        MAX_MOTOR_SPEED,
        HOMING_METHOD,
        HOMING_SPEED,
        HOMING_SPEED_ZERO,
        HOMING_ACCELERATION,
    )
)
"""Objects that only matter to a drive that is enabled later."""
_ONLY = MappingProxyType(
    {
        (QUICK_STOP_OPTION.index, 0): STAY_IN_QUICK_STOP,
        (ABORT_CONNECTION.index, 0): ABORT_QUICK_STOP,
        (FAULT_REACTION.index, 0): FAULT_QUICK_STOP,
    }
)
"""Objects that decide how a drive stops: this value and no other."""


def harmless(word: int) -> bool:
    """Whether a controlword enables and starts nothing, in whatever state the drive is (CiA 402-2, table 32)."""
    return word & ENABLE != ENABLE and not word & START


def may_pass(frame: CanFrame, latched: bool) -> bool:
    """Whether `frame` of the controller may go to the drives."""
    if not latched:
        return True
    if frame.extended or frame.remote:
        return False
    if frame.can_id == NMT:
        return len(frame.data) == 2 and frame.data[0] in _NMT
    function, node = frame.can_id & ~NODES, frame.can_id & NODES
    if node == 0:
        return False
    match function:
        case _ if function == RPDO1:
            return _control(frame.data)
        case _ if function == SDO_REQUEST:
            return _request(frame.data, node)
    return function == HEARTBEAT


def _control(data: bytes) -> bool:
    try:
        return harmless(unpack(LAYOUTS[RPDO1], data)[CONTROLWORD])
    except Malformed:
        return False


def _request(data: bytes, node: int) -> bool:
    """A client's SDO message (CiA 301, 7.2.4.3): its command is in the upper three bits."""
    if len(data) != 8:
        return False
    match data[0] >> 5:
        case 2 | 3 | 4 | 5:  # initiate upload, upload segment, abort, block upload
            return True
        case 1 if data[0] & 0x02:
            size = 4 - (data[0] >> 2 & 3 if data[0] & 0x01 else 0)
            written = int.from_bytes(data[4 : 4 + size], "little")
            return _write(int.from_bytes(data[1:3], "little"), data[3], written, node)
    return False


def _write(index: int, sub: int, value: int, node: int) -> bool:
    if (index, sub) == (CONTROLWORD.index, CONTROLWORD.sub):
        return harmless(value)
    if (index, sub) in _ONLY:
        return value == _ONLY[index, sub]
    return (index, sub) in _SETTINGS or _pdo(index, sub, value, node)


def _pdo(index: int, sub: int, value: int, node: int) -> bool:
    """A PDO parameter may be set as it is used here and not otherwise, or nobody could say what a PDO carries."""
    for function, layout in LAYOUTS.items():
        cob, identifier = pdo_cob(function, node)
        if index == cob.index:
            timer = sub == 5 and function in (TPDO1, TPDO2)
            return (
                value in (identifier, identifier | PDO_OFF) if sub == 1 else timer or (sub == 2 and value == ON_CHANGE)
            )
        if index == pdo_mapping(function):
            return value <= len(layout) if sub == 0 else sub <= len(layout) and value == layout[sub - 1].mapping
    return False


class Gate:
    """Latched from the start, and after each trip, until `clear` names the trip that it clears.

    `epoch` counts trips. Frames say in which epoch their sender was allowed to move something: one that was sent
    before a trip, or before its sender knew of it, is treated as if the gate were latched still.
    """

    def __init__(self) -> None:
        self.epoch = 1
        self.latched = True

    def latch(self) -> None:
        """From now on nothing passes that could move anything."""
        self.epoch += 1
        self.latched = True

    def clear(self, epoch: int) -> bool:
        """Open for senders that know of trip `epoch`; whether that is the last one."""
        if epoch == self.epoch:
            self.latched = False
        return epoch == self.epoch

    def passes(self, frame: CanFrame, epoch: int) -> bool:
        """Whether a frame sent in `epoch` may go to the drives."""
        return may_pass(frame, self.latched or epoch != self.epoch)
