"""While latched only what cannot move anything passes: every controlword, form of an SDO message and identifier."""

from __future__ import annotations

import pytest

from hal.codec import sdo
from hal.codec.cia301 import HEARTBEAT, NMT, RPDO1, RPDO2, SDO_REQUEST, TPDO1, Entry, NmtCommand, heartbeat, nmt, pack
from hal.codec.cia402 import (
    CONTROLWORD,
    ENABLE,
    LAYOUTS,
    MODE,
    PROFILE_VELOCITY,
    QUICK_STOP,
    QUICK_STOP_OPTION,
    START,
    TARGET,
    Mode,
    State,
    commanded,
)
from hal.codec.lawicel import CanFrame
from hal.entries import AXIS_UNITS
from hal.guard.gate import Gate, harmless, may_pass
from hal.real.axis_settings import pdo_settings, settings
from tests.contract.wire_axis import entry_of

NODE = 3
WORDS = range(1 << 16)
BLOCK_DOWNLOAD, BLOCK_UPLOAD, RESERVED = 6, 5, 7


def control(word: int, node: int = NODE) -> CanFrame:
    return CanFrame(RPDO1 + node, pack(LAYOUTS[RPDO1], {CONTROLWORD: word, MODE: Mode.PROFILE_POSITION}))


def request(data: bytes, node: int = NODE) -> CanFrame:
    return CanFrame(SDO_REQUEST + node, data)


def written(entry: Entry, value: int) -> CanFrame:
    return request(next(sdo.download(entry.index, entry.sub, entry.encode(value))))


def test_a_controlword_is_harmless_where_no_state_leads_to_operation_enabled_by_it() -> None:
    for word in WORDS:
        enables = any(commanded(state, word, 0) is State.OPERATION_ENABLED for state in State)
        assert harmless(word) == (not enables and not word & START), hex(word)


def test_of_all_controlwords_only_harmless_ones_pass_by_pdo_and_by_sdo() -> None:
    for word in WORDS:
        assert may_pass(control(word), latched=True) == harmless(word), hex(word)
        assert may_pass(written(CONTROLWORD, word), latched=True) == harmless(word), hex(word)
        assert may_pass(control(word), latched=False)


@pytest.mark.parametrize("word", [0x0000, 0x0002, 0x0006, 0x0007, 0x0080, 0x0100])
def test_stopping_words_pass(word: int) -> None:
    assert may_pass(control(word), latched=True)


@pytest.mark.parametrize("word", [ENABLE, ENABLE | START, 0x003F, 0x008F, 0x010F, 0x0010, 0x0016, 0xFFFF])
def test_moving_words_do_not(word: int) -> None:
    assert not may_pass(control(word), latched=True)


def test_a_control_pdo_of_another_length_says_nobody_knows_what() -> None:
    for length in (0, 1, 2, 4, 8):
        assert not may_pass(CanFrame(RPDO1 + NODE, bytes(length)), latched=True)


def test_every_form_of_writing_the_controlword_is_read_as_the_drive_reads_it() -> None:
    """A command's lower bits say how many bytes count; the size bit may be left away, the data is then 4 bytes."""
    address = CONTROLWORD.index.to_bytes(2, "little") + bytes([CONTROLWORD.sub])
    for command in range(1 << 8):
        for word in (QUICK_STOP, ENABLE):
            data = bytes([command]) + address + word.to_bytes(4, "little")
            passes = may_pass(request(data), latched=True)
            match command >> 5:
                case 1:  # initiate download: expedited where bit 1 is set, otherwise the first of segments
                    assert passes == (bool(command & 0x02) and word == QUICK_STOP), hex(command)
                case 2 | 3 | 4 | 5:  # reading, and aborts
                    assert passes, hex(command)
                case _:  # segments of a download, block download, reserved
                    assert not passes, hex(command)


@pytest.mark.parametrize("command", [0x00, 0x01, 0x0D, 0x10, 0x1D, 0x21, 0x20, 0xC0, 0xC2, 0xC6, 0xE0])
def test_no_part_of_a_transfer_in_segments_or_blocks_passes(command: int) -> None:
    for length in range(9):
        data = (bytes([command]) + CONTROLWORD.index.to_bytes(2, "little") + bytes(8))[:length]
        assert not may_pass(request(data), latched=True)


@pytest.mark.parametrize(
    "entry", [MODE, TARGET, PROFILE_VELOCITY, Entry(0x60FF, 0, "i", ""), Entry(0x6071, 0, "h", "")]
)
def test_set_points_are_not_written(entry: Entry) -> None:
    assert not may_pass(written(entry, 1), latched=True)
    assert may_pass(request(next(sdo.upload(entry.index, entry.sub))), latched=True)


def test_of_all_objects_only_settings_may_be_written() -> None:
    open_ = {index for index in WORDS if may_pass(written(Entry(index, 0, "H", ""), QUICK_STOP), latched=True)}
    assert open_ == {
        0x1017, 0x605E, CONTROLWORD.index, 0x6065, 0x6080, 0x6083, 0x6084, 0x6085, 0x6098, 0x609A,
        0x1600, 0x1601, 0x1A00, 0x1A01,
    }  # fmt: skip


def test_a_drive_is_set_up_through_a_latched_gate() -> None:
    for number, name in enumerate(AXIS_UNITS, start=1):
        entry = entry_of(name, number)
        for one, value in (*pdo_settings(entry), *settings(entry, 127).items()):
            message = next(sdo.download(one.index, one.sub, one.encode(value)))
            assert may_pass(request(message, number), latched=True), (str(one), value)
            assert may_pass(request(next(sdo.upload(one.index, one.sub)), number), latched=True)


def test_what_a_pdo_carries_is_not_changed() -> None:
    """Another mapping or identifier would carry a controlword where nobody looks for one."""
    for index, sub, code, value in (
        (0x1600, 1, "I", 0x60400010 ^ 0x00010000),
        (0x1601, 1, "I", 0x60400010),
        (0x1601, 0, "B", 3),
        (0x1400, 1, "I", RPDO1 + NODE + 1),
        (0x1401, 1, "I", RPDO1 + NODE),
        (0x1402, 1, "I", 0x400 + NODE),
        (0x1602, 1, "I", 0x60400010),
        (0x1800, 1, "I", RPDO1 + NODE),
        (0x1400, 2, "B", 1),
    ):
        assert not may_pass(written(Entry(index, sub, code, ""), value), latched=True), hex(index)


def test_how_a_drive_stops_is_not_changed() -> None:
    assert may_pass(written(QUICK_STOP_OPTION, 6), latched=True)
    for value in (-1, 0, 1, 2, 5, 7):
        assert not may_pass(written(QUICK_STOP_OPTION, value), latched=True)


def test_network_management_passes_short_of_a_reset() -> None:
    for command in range(1 << 8):
        allowed = command in (NmtCommand.START, NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL)
        assert may_pass(CanFrame(NMT, bytes([command, NODE])), latched=True) == allowed
    assert not may_pass(CanFrame(NMT, bytes([NmtCommand.START])), latched=True)
    assert may_pass(nmt(NmtCommand.START, 0), latched=True)


def test_of_all_identifiers_only_known_ones_pass() -> None:
    stop = pack(LAYOUTS[RPDO1], {CONTROLWORD: QUICK_STOP, MODE: 1})
    for can_id in range(1 << 11):
        function, node = can_id & ~0x7F, can_id & 0x7F
        assert may_pass(CanFrame(can_id, stop), latched=True) == (node > 0 and function in (RPDO1, HEARTBEAT))
        assert not may_pass(CanFrame(can_id, stop, extended=True), latched=True)
        assert not may_pass(CanFrame(can_id, b"", remote=True), latched=True)
    assert not may_pass(CanFrame(RPDO2 + NODE, bytes(8)), latched=True)
    assert not may_pass(CanFrame(TPDO1 + NODE, bytes(3)), latched=True)
    assert may_pass(heartbeat(NODE), latched=True)


def test_the_gate_opens_for_who_knows_of_the_last_trip() -> None:
    gate, go = Gate(), control(ENABLE)
    assert not gate.passes(go, gate.epoch)
    assert gate.clear(gate.epoch)
    before = gate.epoch
    assert gate.passes(go, before)
    gate.latch()
    assert not gate.passes(go, before)
    assert not gate.clear(before), "it does not know of the second trip"
    assert not gate.passes(go, before)
    assert gate.clear(gate.epoch)
    assert not gate.passes(go, before), "sent before the trip, still on its way"
    assert gate.passes(control(QUICK_STOP), before)
    assert gate.passes(go, gate.epoch)
