"""SDO transfers, byte by byte as in CiA 301 7.2.4, and against each other."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.codec.sdo import NO_OBJECT, TOGGLE, UNKNOWN_COMMAND, SdoAbort, SdoServer, Transfer, belongs, download, upload

READ_DEVICE_TYPE = [("4000100000000000", "4300100092010200")]
WRITE_HEARTBEAT = [("2B171000E8030000", "6017100000000000")]
WRITE_BYTE = [("2F60600001000000", "6060600000000000")]
READ_NAME = [
    ("4008100000000000", "410810001A000000"),
    ("6000000000000000", "0054696E79204E6F"),
    ("7000000000000000", "106465202D204D65"),
    ("6000000000000000", "00676120446F6D61"),
    ("7000000000000000", "15696E7320210000"),
]
WRITE_LONG = [
    ("2108100009000000", "6008100000000000"),
    ("0041424344454647", "2000000000000000"),
    ("1B48490000000000", "3000000000000000"),
]


def talk(transfer: Transfer, lines: list[tuple[str, str]]) -> bytes:
    """Let `transfer` meet exactly these requests and replies."""
    try:
        request = next(transfer)
        for asked, said in lines:
            assert request.hex().upper() == asked
            request = transfer.send(bytes.fromhex(said))
    except StopIteration as done:
        return bytes(done.value)
    raise AssertionError("asks for more")


def test_transfers_byte_by_byte() -> None:
    assert talk(upload(0x1000, 0), READ_DEVICE_TYPE) == bytes.fromhex("92010200")
    assert talk(upload(0x1008, 0), READ_NAME) == b"Tiny Node - Mega Domains !"
    assert talk(download(0x1017, 0, (1000).to_bytes(2, "little")), WRITE_HEARTBEAT) == b""
    assert talk(download(0x6060, 0, b"\x01"), WRITE_BYTE) == b""
    assert talk(download(0x1008, 0, b"ABCDEFGHI"), WRITE_LONG) == b""


def test_the_server_byte_by_byte() -> None:
    written: dict[tuple[int, int], bytes] = {}
    held = {0x1000: bytes.fromhex("92010200"), 0x1008: b"Tiny Node - Mega Domains !"}
    server = SdoServer(lambda index, sub: held[index], lambda index, sub, data: written.update({(index, sub): data}))
    for lines in (READ_DEVICE_TYPE, READ_NAME, WRITE_HEARTBEAT, WRITE_BYTE, WRITE_LONG):
        for asked, said in lines:
            answer = server.answer(bytes.fromhex(asked))
            assert answer is not None
            assert answer.hex().upper() == said
    assert written == {(0x1017, 0): b"\xe8\x03", (0x6060, 0): b"\x01", (0x1008, 0): b"ABCDEFGHI"}


def test_an_abort_names_object_and_reason() -> None:
    with pytest.raises(SdoAbort, match=r"0x6099:1.*0x06020000: object does not exist") as caught:
        talk(upload(0x6099, 1), [("4099600100000000", "8099600100000206")])
    assert caught.value.code == NO_OBJECT


def test_the_server_aborts_what_it_does_not_know_and_answers_no_abort() -> None:
    def refuse(index: int, sub: int) -> bytes:
        raise SdoAbort(index, sub, NO_OBJECT)

    server = SdoServer(refuse, lambda *_: None)
    assert server.answer(bytes.fromhex("4099600100000000")) == bytes.fromhex("8099600100000206")
    assert server.answer(bytes.fromhex("8099600100000405")) is None
    assert server.answer(b"\x40") is None
    for stray in ("6000000000000000", "0000000000000000", "A000000000000000"):
        answer = server.answer(bytes.fromhex(stray))
        assert answer is not None
        assert int.from_bytes(answer[4:], "little") == UNKNOWN_COMMAND


def test_a_repeated_segment_is_aborted_by_the_server() -> None:
    server = SdoServer(lambda *_: b"0123456789", lambda *_: None)
    server.answer(bytes.fromhex("4008100000000000"))
    assert server.answer(bytes.fromhex("6000000000000000")) is not None
    answer = server.answer(bytes.fromhex("6000000000000000"))
    assert answer is not None
    assert int.from_bytes(answer[4:], "little") == TOGGLE


@given(st.binary(min_size=1, max_size=60))
def test_client_and_server_carry_any_data(data: bytes) -> None:
    held: dict[int, bytes] = {}
    server = SdoServer(lambda index, _: held[index], lambda index, _, data: held.update({index: data}))

    def run(transfer: Transfer) -> bytes:
        try:
            request = next(transfer)
            while True:
                answer = server.answer(request)
                assert answer is not None
                assert belongs(request, answer)
                request = transfer.send(answer)
        except StopIteration as done:
            return bytes(done.value)

    run(download(0x2000, 1, data))
    assert run(upload(0x2000, 1)) == data


@pytest.mark.parametrize(
    ("request_", "reply", "answers"),
    [
        ("4041600000000000", "4B41600037020000", True),
        ("4041600000000000", "4364600037020000", False),  # another object
        ("4041600000000000", "6041600000000000", False),  # of a download
        ("2B40600006000000", "6040600000000000", True),
        ("4041600000000000", "8041600000000206", True),
        ("4041600000000000", "8064600000000206", False),
        ("6000000000000000", "0054696E79204E6F", True),
        ("7000000000000000", "0054696E79204E6F", False),  # the segment before, once more
        ("4041600000000000", "4B416000", False),
    ],
)
def test_a_reply_counts_for_its_own_request_only(request_: str, reply: str, answers: bool) -> None:
    assert belongs(bytes.fromhex(request_), bytes.fromhex(reply)) is answers
