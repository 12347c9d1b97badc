"""Drives (CiA 402-2): objects, status- and controlword, states, the whole profile position handshake, error codes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType

from hal.codec.cia301 import RPDO1, RPDO2, TPDO1, TPDO2, Entry

ERROR_CODE = Entry(0x603F, 0, "H", "error code")
CONTROLWORD = Entry(0x6040, 0, "H", "controlword")
STATUSWORD = Entry(0x6041, 0, "H", "statusword")
ABORT_CONNECTION = Entry(0x6007, 0, "h", "abort connection option")
QUICK_STOP_OPTION = Entry(0x605A, 0, "h", "quick stop option")
FAULT_REACTION = Entry(0x605E, 0, "h", "fault reaction option")
MODE = Entry(0x6060, 0, "b", "mode of operation")
MODE_SHOWN = Entry(0x6061, 0, "b", "mode of operation display")
POSITION = Entry(0x6064, 0, "i", "position actual value")
FOLLOWING_WINDOW = Entry(0x6065, 0, "I", "following error window")
VELOCITY = Entry(0x606C, 0, "i", "velocity actual value")
TARGET = Entry(0x607A, 0, "i", "target position")
LIMIT_LOW = Entry(0x607D, 1, "i", "software position limit low")
LIMIT_HIGH = Entry(0x607D, 2, "i", "software position limit high")
MAX_MOTOR_SPEED = Entry(0x6080, 0, "I", "max motor speed")
PROFILE_VELOCITY = Entry(0x6081, 0, "I", "profile velocity")
PROFILE_ACCELERATION = Entry(0x6083, 0, "I", "profile acceleration")
PROFILE_DECELERATION = Entry(0x6084, 0, "I", "profile deceleration")
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "I", "quick stop deceleration")
ENCODER_INCREMENTS = Entry(0x608F, 1, "I", "encoder increments")
ENCODER_REVOLUTIONS = Entry(0x608F, 2, "I", "encoder resolution, motor revolutions")
GEAR_MOTOR = Entry(0x6091, 1, "I", "gear ratio, motor revolutions")
GEAR_SHAFT = Entry(0x6091, 2, "I", "gear ratio, shaft revolutions")
FEED = Entry(0x6092, 1, "I", "feed constant, feed")
FEED_SHAFT = Entry(0x6092, 2, "I", "feed constant, shaft revolutions")
HOMING_METHOD = Entry(0x6098, 0, "b", "homing method")
HOMING_SPEED = Entry(0x6099, 1, "I", "homing speed towards the switch")
HOMING_SPEED_ZERO = Entry(0x6099, 2, "I", "homing speed towards zero")
HOMING_ACCELERATION = Entry(0x609A, 0, "I", "homing acceleration")
OUTPUTS = Entry(0x60FE, 1, "I", "digital outputs")

BRAKE_SET = 0x1
"""Bit of 0x60FE:1."""
STAY_IN_QUICK_STOP = 6
"""Of 0x605A: stop on the quick stop ramp, hold torque and stay in quick stop."""
ABORT_QUICK_STOP = 3
"""Of 0x6007: quick stop on lost communication."""
FAULT_QUICK_STOP = 2
"""Of 0x605E: stop on the quick stop ramp."""

LAYOUTS = MappingProxyType(
    {
        TPDO1: (STATUSWORD, MODE_SHOWN),
        TPDO2: (POSITION, VELOCITY),
        RPDO1: (CONTROLWORD, MODE),
        RPDO2: (TARGET, PROFILE_VELOCITY),
    }
)
"""What each PDO of a drive carries."""


class Mode(IntEnum):
    """Modes of operation that are used here."""

    NONE = 0
    PROFILE_POSITION = 1
    HOMING = 6


class State(Enum):
    """States of the power drive system, by the bits of the statusword (mask, value)."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP_ACTIVE = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)


VOLTAGE, TARGET_REACHED, INTERNAL_LIMIT, ACKNOWLEDGED, DEVIATION = 4, 10, 11, 12, 13
"""Bits of the statusword. 12: set-point acknowledged, or homing attained; 13: following or homing error."""


@dataclass(frozen=True, slots=True)
class Status:
    """A statusword."""

    word: int

    @property
    def state(self) -> State:
        """Every word without an own pattern counts as not ready."""
        found = (state for state in State if self.word & state.value[0] == state.value[1])
        return next(found, State.NOT_READY)

    def bit(self, number: int) -> bool:
        """One bit."""
        return bool(self.word >> number & 1)

    @property
    def voltage(self) -> bool:
        """Whether the power stage is supplied; false under STO."""
        return self.bit(VOLTAGE)

    @property
    def reached(self) -> bool:
        """Target reached; in quick stop: the drive has come to a stand."""
        return self.bit(TARGET_REACHED)

    @property
    def acknowledged(self) -> bool:
        """Set-point acknowledged, or homing attained."""
        return self.bit(ACKNOWLEDGED)

    @property
    def held(self) -> bool:
        """Whether the drive holds the axis under torque."""
        return self.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)

    @property
    def at_rest(self) -> bool:
        """Whether the drive says that it neither moves nor is about to."""
        match self.state:
            case State.OPERATION_ENABLED | State.QUICK_STOP_ACTIVE:
                return self.reached
            case State.FAULT_REACTION | State.NOT_READY:
                return False
        return True


DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, FAULT_RESET = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
START, IMMEDIATELY = 0x10, 0x20
"""Bits of the controlword: a new set-point or the start of homing; the set-point replaces the one under way."""


def toward_enabled(state: State) -> int | None:
    """The controlword that brings a drive one state nearer to operation enabled; None where it can only wait."""
    match state:
        case State.FAULT:
            return FAULT_RESET
        case State.SWITCH_ON_DISABLED:
            return SHUTDOWN
        case State.READY_TO_SWITCH_ON:
            return SWITCH_ON
        case State.SWITCHED_ON | State.QUICK_STOP_ACTIVE | State.OPERATION_ENABLED:
            return ENABLE
    return None


def commanded(state: State, word: int, before: int) -> State:
    """The state that controlword `word` leads to (`before` is the last one: a fault is reset by the edge of bit 7).

    Table 32 of CiA 402-2, with 0x605A = 6: "enable operation" leaves quick stop.
    """
    if state is State.FAULT:
        return State.SWITCH_ON_DISABLED if word & ~before & FAULT_RESET else state
    if state in (State.NOT_READY, State.FAULT_REACTION):
        return state
    if not word & 0x02:
        return State.SWITCH_ON_DISABLED
    if not word & 0x04:
        live = state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
        return State.QUICK_STOP_ACTIVE if live else State.SWITCH_ON_DISABLED
    if state is State.QUICK_STOP_ACTIVE:
        return State.OPERATION_ENABLED if word & 0x0F == ENABLE else state
    if not word & 0x01:
        return State.READY_TO_SWITCH_ON
    if state is State.SWITCH_ON_DISABLED:
        return state
    if state is State.READY_TO_SWITCH_ON:
        return State.SWITCHED_ON
    return State.OPERATION_ENABLED if word & 0x08 else State.SWITCHED_ON


class Step(Enum):
    """Where the handshake of one motion stands."""

    CLEAR = "start bit down, waiting for bit 12 to fall"
    RAISE = "start bit up, waiting for the drive's answer"
    LOWER = "start bit down again, waiting for bit 12 to fall"
    TRAVEL = "under way, waiting for bit 10"
    DONE = "done"


POSITION_WORDS = MappingProxyType(
    {Step.CLEAR: ENABLE, Step.RAISE: ENABLE | START | IMMEDIATELY, Step.LOWER: ENABLE, Step.TRAVEL: ENABLE}
)
"""Controlword by step in profile position."""
HOMING_WORDS = MappingProxyType({Step.CLEAR: ENABLE, Step.RAISE: ENABLE | START, Step.TRAVEL: ENABLE | START})
"""Controlword by step in homing: the start bit stays up until it is done."""


def position_step(step: Step, status: Status) -> Step:
    """The step after `step` once `status` answers it, else `step`. Bit 10 counts only after the whole handshake: before
    it the bit still speaks of the motion before."""
    match step:
        case Step.CLEAR if not status.acknowledged:
            return Step.RAISE
        case Step.RAISE if status.acknowledged:
            return Step.LOWER
        case Step.LOWER if not status.acknowledged:
            return Step.TRAVEL
        case Step.TRAVEL if status.reached:
            return Step.DONE
    return step


def homing_step(step: Step, status: Status) -> Step:
    """As `position_step` for homing, which has begun only once "attained" and "reached" of the one before are gone."""
    match step:
        case Step.CLEAR:
            return Step.RAISE
        case Step.RAISE if not status.acknowledged and not status.reached:
            return Step.TRAVEL
        case Step.TRAVEL if status.acknowledged and status.reached:
            return Step.DONE
    return step


FOLLOWING_ERROR, HEARTBEAT_ERROR = 0x8611, 0x8130
ERRORS = MappingProxyType(
    {
        0x2310: "continuous over-current",
        0x3210: "over-voltage of the DC link",
        0x3220: "under-voltage of the DC link",
        0x4310: "over-temperature of the drive",
        0x7121: "motor blocked",
        0x7305: "encoder failed",
        0x8110: "CAN overrun",
        0x8120: "CAN error passive",
        HEARTBEAT_ERROR: "heartbeat lost",
        0x8140: "recovered from bus-off",
        0x8500: "position controller",
        FOLLOWING_ERROR: "following error",
        0x8612: "reference limit",
    }
)
"""Words for error codes (CiA 402-2, table 4; CiA 301, table 26)."""


def error_text(code: int) -> str:
    """What a drive's error code means."""
    return f"{ERRORS[code]} ({code:#06x})" if code in ERRORS else f"error code {code:#06x}"
