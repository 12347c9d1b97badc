"""Open Protocol: header, framing and messages, against printed frames.

The frames are the examples of the specification (9836 4415 01), as public implementations of it reprint them in their
tests; revision 2 of MID 0061 was recorded from a controller.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from hal.codec import open_protocol_messages as m
from hal.codec.open_protocol import Framer, Message, OpenProtocolError, encode
from hal.codec.open_protocol_result import Result, old_result, read_result, result

STARTED = b"00570002001         010001020103Airbag1                  "
STARTED_4 = (
    b"01630002004         010001020103Airbag1                  04ACT05OpenProtocolVersion06Version 19.0.0.0   "
    b"07Version 01.0.0.0   08RBUType                 09Serial    "
)
SET = b"01040013            0100102Airbag1                  0310403050012000600150007001400080036009007201000480"
SELECTED_2 = (
    b"01410015002         0100202Airbag parameter         032017-06-02:09:54:0904205040600510107010009080050050"
    b"900001109999911003601200123413001006"
)
TOOL = b"00810041001         01ABCDEFG-123456024294967295032017-12-01:20:12:4504GFEDCBA-10"
RESULT = (
    b"02310061001         010001020103airbag7                  04KPOL3456JKLO897          0500060030700000800000901"
    b"00111120008401300140014001200150007391600000170999918000001900000202001-06-02:09:54:09212001-05-29:12:34:33"
    b"221230000345675"
)
RESULT_2 = (
    b"03850061002         010000020003RA ST6.2 ETV100          04                         0500000600107020800067"
    b"0900001000001101221301401501611711811912000000081942100340022004600230040002400050525000202600420270000028"
    b"000002900100300085031000043200033150340003500000036999900370000003800000039000000400000004100001848874200000"
    b"430000044      C0761275452020-06-25:01:04:39462020-06-24:10:48:53"
)
OLD = (
    b"01180065001         01012345678902AIRBAG                   03001040002050060070080014670900046"
    b"102001-04-22:14:54:34112"
)

NUMBERS: list[tuple[bytes, int, int, int]] = [
    (b"00240005            0018", m.ACCEPTED, 4, 18),
    (b"00230012            002", m.SET_ASK, 3, 2),
    (b"00230018001         022", m.SELECT, 3, 22),
    (b"00300064001         0123456789", m.OLD_RESULT_ASK, 10, 123456789),
    (b"00230216   1        026", m.RELAY_SUBSCRIBE, 3, 26),
    (b"00230224            065", m.INPUT_SET, 3, 65),
    (b"00230225            055", m.INPUT_RESET, 3, 55),
]
"""Printed message, its MID, width and value of its number."""

BARE: list[tuple[bytes, int]] = [
    (b"00200003001         ", m.STOP),
    (b"00200014            ", m.SELECTED_SUBSCRIBE),
    (b"00200016            ", m.SELECTED_ACK),
    (b"00200017            ", m.SELECTED_UNSUBSCRIBE),
    (b"00200060001         ", m.RESULT_SUBSCRIBE),
    (b"00200078            ", m.ALARM_CLEAR),
    (b"00209999            ", m.KEEP_ALIVE),
]

WHOLE: list[tuple[bytes, Callable[[Message], Any], Any, Callable[[Any], Message]]] = [
    (STARTED, m.read_started, m.Started(1, 1, "Airbag1"), lambda v: m.started(v, 1)),
    (
        STARTED_4,
        m.read_started,
        m.Started(
            1, 1, "Airbag1", "ACT", "OpenProtocolVersion", "Version 19.0.0.0", "Version 01.0.0.0", "RBUType", "Serial"
        ),
        lambda v: m.started(v, 4),
    ),
    (b"00260004            001802", m.read_refused, (18, 2), lambda v: m.refused(*v)),
    (b"00290011            002001002", m.read_set_ids, (1, 2), m.set_ids),
    (SET, m.read_set, m.ParameterSet(1, "Airbag1", 1, 3, 12.0, 15.0, 14.0, 360, 720, 480), m.set_data),
    (
        b"00420015001         0022017-06-02:09:54:09",
        m.read_selected,
        (2, "2017-06-02:09:54:09"),
        lambda v: m.selected(*v),
    ),
    (
        TOOL,
        m.read_tool,
        ("ABCDEFG-123456", "GFEDCBA-10"),
        lambda v: m.tool_data(*v, 4294967295, "2017-12-01:20:12:45"),
    ),
    (
        b"00530071001         01E851021031042017-12-01:20:12:45",
        m.read_alarm,
        m.Alarm("E851", True, True, "2017-12-01:20:12:45"),
        m.alarm,
    ),
    (
        b"00560076001         01102E851031041052017-01-25:10:20:20",
        m.read_alarm,
        m.Alarm("E851", True, True, "2017-01-25:10:20:20"),
        m.alarm_status,
    ),
    (b"00280217   1        01026021", m.read_relay, (26, True), lambda v: m.relay(*v)),
    (
        RESULT,
        read_result,
        Result(
            number=345675,
            identifier="KPOL3456JKLO897",
            parameter_set=3,
            ok=False,
            torque_status=0,
            angle_status=1,
            torque_nm=7.39,
            angle_deg=0,
            stamp="2001-06-02:09:54:09",
            cell=1,
            channel=1,
            controller="airbag7",
            torque_low_nm=8.40,
            torque_high_nm=14.00,
            target_torque_nm=12.00,
            angle_high_deg=9999,
            changed="2001-05-29:12:34:33",
            batch_status=1,
        ),
        lambda v: result(v, 1),
    ),
    (
        OLD,
        read_result,
        Result(123456789, "AIRBAG", 1, False, 0, 0, 14.67, 46, "2001-04-22:14:54:34", batch_counter=2, batch_status=2),
        old_result,
    ),
]
"""Printed message, how it is read, what it says, how that is written."""


def one(printed: bytes) -> Message:
    messages = Framer().feed(printed + b"\0")
    assert len(messages) == 1
    return messages[0]


def alike(ours: bytes, printed: bytes) -> bool:
    """Byte for byte, but a blank revision is 001 and the no-ack flag is the subscriber's."""
    revision = printed[8:11] if printed[8:11].strip() else b"001"
    return ours == printed[:8] + revision + ours[11:12] + printed[12:] + b"\0"


@pytest.mark.parametrize(
    ("printed", "read", "says", "write"), WHOLE, ids=lambda v: v[:8].decode() if isinstance(v, bytes) else ""
)
def test_printed_messages_are_read_and_written(
    printed: bytes, read: Callable[[Message], Any], says: Any, write: Callable[[Any], Message]
) -> None:
    assert read(one(printed)) == says
    assert alike(encode(write(says)), printed)


@pytest.mark.parametrize(("printed", "mid", "width", "value"), NUMBERS)
def test_printed_numbers_are_read_and_written(printed: bytes, mid: int, width: int, value: int) -> None:
    message = one(printed)
    assert message.mid == mid
    assert m.read_number(message, width) == value
    assert alike(encode(m.numbered(mid, value, width)), printed)


@pytest.mark.parametrize(("printed", "mid"), BARE)
def test_printed_headers_are_read_and_written(printed: bytes, mid: int) -> None:
    assert one(printed) == Message(mid)
    assert alike(encode(Message(mid)), printed)


def test_a_header_with_its_revision_as_a_manual_of_the_vendor_prints_it() -> None:
    """9839 0732 01 (MT Focus 6000), "Start communication"."""
    printed = b"002000010060        "
    assert one(printed) == Message(1, revision=6)
    assert alike(encode(Message(1, revision=6)), printed)


def test_revision_2_of_a_result_says_the_same_in_other_places() -> None:
    value = read_result(one(RESULT_2))
    assert (value.number, value.parameter_set, value.ok) == (184887, 1, False)
    assert (value.torque_status, value.angle_status, value.batch_status) == (0, 0, 2)
    assert (value.torque_low_nm, value.torque_high_nm, value.torque_nm) == (34.0, 46.0, 5.05)
    assert (value.angle_low_deg, value.angle_high_deg, value.angle_deg) == (20, 420, 0)
    assert value.stamp == "2020-06-25:01:04:39"
    assert len(encode(result(value, 2))) == 386
    assert read_result(one(encode(result(value, 2))[:-1])) == value


def test_a_later_revision_of_the_selected_set_is_read_by_its_number() -> None:
    assert m.read_selected(one(SELECTED_2))[0] == 2


def test_the_subject_of_a_subscription_is_read_and_written() -> None:
    printed = b"00430008            002200214lengthequals14"
    assert m.read_subject(one(printed)) == (22, 2, b"lengthequals14")
    assert alike(encode(m.subscription(22, 2, b"lengthequals14")), printed)
    printed = b"00430006            001800214lengthequals14"
    assert m.read_subject(one(printed)) == (18, 2, b"lengthequals14")
    assert alike(encode(m.request(18, 2, b"lengthequals14")), printed)


def test_every_cut_of_a_stream_gives_the_same_messages() -> None:
    parts = [printed + b"\0" for printed, *_ in WHOLE]
    binary = encode(Message(m.TRACE, b"text\0\x00\x01\x00\x00"))
    stream = b"".join([*parts, binary, *parts, binary + b"\0", *parts])
    whole = Framer().feed(stream)
    assert len(whole) == 3 * len(parts) + 2
    rng = random.Random(7)
    for _ in range(50):
        framer, got, at = Framer(), [], 0
        while at < len(stream):
            step = rng.choice((1, 2, 19, 20, 21, 64, 300))
            got += framer.feed(stream[at : at + step])
            at += step
        assert got == whole


@pytest.mark.parametrize(
    ("stream", "place"),
    [
        (b"0x200060001         \0", "length"),
        (b"00190060001         \0", "length"),
        (b"002000A0001         \0", "MID"),
        (b"00200060xyz         \0", "revision"),
        (b"00200060001         X", "MID 0060"),
    ],
)
def test_a_stream_that_is_none_is_refused_with_its_place(stream: bytes, place: str) -> None:
    with pytest.raises(OpenProtocolError) as caught:
        Framer().feed(stream)
    assert caught.value.place == place


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(OpenProtocolError, match="4 digits"):
        encode(Message(m.IDENTIFIER, b"x" * 9990))
    with pytest.raises(OpenProtocolError, match="25 characters"):
        result(Result(1, "x" * 26, 1, True, 1, 1, 1.0, 1, ""), 1)
    with pytest.raises(OpenProtocolError, match="6 digits"):
        result(Result(1, "x", 1, True, 1, 1, 1e5, 1, ""), 1)


def test_a_message_that_is_cut_or_shifted_says_which_field() -> None:
    with pytest.raises(OpenProtocolError, match="controller"):
        m.read_started(Message(m.STARTED, STARTED[20:40]))
    with pytest.raises(OpenProtocolError, match="channel"):
        m.read_started(Message(m.STARTED, STARTED[20:26] + b"x" + STARTED[26:]))
