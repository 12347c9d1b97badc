"""CiA 301 and 402: printed bit patterns, layouts, and the handshake of a motion."""

from __future__ import annotations

import pytest

from hal.codec import cia301, cia402
from hal.codec.cia301 import Emergency, Entry, Malformed, NmtCommand, NmtState
from hal.codec.cia402 import State, Status, Step, commanded, homing_step, position_step, toward_enabled
from hal.codec.lawicel import CanFrame


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0000, State.NOT_READY),
        (0x0250, State.SWITCH_ON_DISABLED),
        (0x0270, State.SWITCH_ON_DISABLED),
        (0x0231, State.READY_TO_SWITCH_ON),
        (0x0233, State.SWITCHED_ON),
        (0x0237, State.OPERATION_ENABLED),
        (0x1637, State.OPERATION_ENABLED),
        (0x0217, State.QUICK_STOP_ACTIVE),
        (0x021F, State.FAULT_REACTION),
        (0x0218, State.FAULT),
        (0x0238, State.FAULT),
    ],
)
def test_states_by_the_bits_of_the_statusword(word: int, state: State) -> None:
    assert Status(word).state is state


def test_a_drive_is_led_to_operation_enabled_from_every_state_that_can_be_left() -> None:
    for start in State:
        state, word = start, 0
        for _ in range(4):
            wanted = toward_enabled(state)
            if wanted is not None:
                state, word = commanded(state, wanted, word), wanted
        stuck = start in (State.NOT_READY, State.FAULT_REACTION)
        assert state is (start if stuck else State.OPERATION_ENABLED)


@pytest.mark.parametrize(
    ("state", "word", "after"),
    [
        (State.OPERATION_ENABLED, cia402.QUICK_STOP, State.QUICK_STOP_ACTIVE),
        (State.OPERATION_ENABLED, cia402.DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED),
        (State.OPERATION_ENABLED, cia402.SHUTDOWN, State.READY_TO_SWITCH_ON),
        (State.OPERATION_ENABLED, cia402.SWITCH_ON, State.SWITCHED_ON),
        (State.QUICK_STOP_ACTIVE, cia402.ENABLE, State.OPERATION_ENABLED),
        (State.QUICK_STOP_ACTIVE, cia402.SHUTDOWN, State.QUICK_STOP_ACTIVE),
        (State.QUICK_STOP_ACTIVE, cia402.DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED),
        (State.SWITCH_ON_DISABLED, cia402.ENABLE, State.SWITCH_ON_DISABLED),
        (State.READY_TO_SWITCH_ON, cia402.QUICK_STOP, State.SWITCH_ON_DISABLED),
        (State.FAULT, cia402.ENABLE, State.FAULT),
    ],
)
def test_transitions_of_the_standard(state: State, word: int, after: State) -> None:
    assert commanded(state, word, 0) is after


def test_a_fault_is_reset_by_an_edge_only() -> None:
    assert commanded(State.FAULT, cia402.FAULT_RESET, cia402.FAULT_RESET) is State.FAULT


REACHED, ACKNOWLEDGED = 0x0637, 0x1237
PLAIN = 0x0237


def test_target_reached_counts_only_after_the_whole_handshake() -> None:
    seen, step = [], Step.CLEAR
    for word in (0x1637, REACHED, REACHED, ACKNOWLEDGED, ACKNOWLEDGED, PLAIN, PLAIN, REACHED):
        step = position_step(step, Status(word))
        seen.append(step)
    assert seen == [
        Step.CLEAR,
        Step.RAISE,
        Step.RAISE,  # "reached" of the motion before
        Step.LOWER,
        Step.LOWER,
        Step.TRAVEL,
        Step.TRAVEL,
        Step.DONE,
    ]


def test_homing_is_done_only_after_it_was_seen_to_begin() -> None:
    seen, step = [], Step.CLEAR
    for word in (0x1637, 0x1637, PLAIN, ACKNOWLEDGED, 0x1637):
        step = homing_step(step, Status(word))
        seen.append(step)
    assert seen == [Step.RAISE, Step.RAISE, Step.TRAVEL, Step.TRAVEL, Step.DONE]


def test_standing_is_what_the_drive_says_in_each_state() -> None:
    assert not Status(PLAIN).at_rest
    assert Status(REACHED).at_rest
    assert not Status(0x0217).at_rest
    assert Status(0x0617).at_rest
    assert not Status(0x061F).at_rest
    assert Status(0x0218).at_rest


def test_layouts_byte_by_byte() -> None:
    values = {cia402.CONTROLWORD: 0x1F, cia402.MODE: 1}
    assert cia301.pack(cia402.LAYOUTS[cia301.RPDO1], values).hex() == "1f0001"
    data = bytes.fromhex("f0d8ffff e8030000")
    assert cia301.unpack(cia402.LAYOUTS[cia301.TPDO2], data) == {cia402.POSITION: -10000, cia402.VELOCITY: 1000}
    assert cia402.STATUSWORD.mapping == 0x60410010
    assert cia402.POSITION.mapping == 0x60640020
    assert cia301.consumer_heartbeat(127, 200) == 0x007F00C8
    assert cia301.heartbeat(127) == CanFrame(0x77F, b"\x05")
    assert cia301.nmt(NmtCommand.START, 5) == CanFrame(0x000, b"\x01\x05")
    assert cia301.heartbeat_state(b"\x7f") is NmtState.PRE_OPERATIONAL
    assert Emergency.decode(bytes.fromhex("1186210000000000")) == Emergency(0x8611, 0x21)
    assert Emergency(0x8611, 0x21).encode().hex() == "1186210000000000"
    assert "following error" in cia402.error_text(0x8611)


def test_what_is_malformed_says_so() -> None:
    for act in (
        lambda: cia301.unpack(cia402.LAYOUTS[cia301.TPDO1], b"\x37\x02"),
        lambda: cia301.heartbeat_state(b""),
        lambda: cia301.heartbeat_state(b"\x33"),
        lambda: Emergency.decode(b"\x00"),
        lambda: Entry(0x6060, 0, "b", "mode").encode(300),
        lambda: Entry(0x6060, 0, "b", "mode").decode(b"\x00\x00"),
    ):
        with pytest.raises(Malformed):
            act()
