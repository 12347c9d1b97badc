"""Service data objects (CiA 301, 7.2.4): expedited and segmented transfers as sequences of 8-byte messages.

A client's transfer is a generator: it yields a request and is sent the reply. The server is `SdoServer`. Neither knows
of buses, identifiers or time; deadlines are the caller's. Block transfer is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from types import MappingProxyType

TIMED_OUT = 0x05040000
TOGGLE = 0x05030000
UNKNOWN_COMMAND = 0x05040001
NO_OBJECT = 0x06020000
NO_SUBINDEX = 0x06090011
READ_ONLY = 0x06010002
LENGTH = 0x06070010
RANGE = 0x06090030
DEVICE_STATE = 0x08000022

ABORTS = MappingProxyType(
    {
        TOGGLE: "toggle bit not alternated",
        TIMED_OUT: "transfer timed out",
        UNKNOWN_COMMAND: "unknown command",
        0x06010000: "access not supported",
        0x06010001: "object is write-only",
        READ_ONLY: "object is read-only",
        NO_OBJECT: "object does not exist",
        0x06040041: "object cannot be mapped",
        0x06040042: "mapped objects are too long for a PDO",
        0x06060000: "hardware error",
        LENGTH: "length does not match",
        NO_SUBINDEX: "sub-index does not exist",
        RANGE: "value out of range",
        0x08000000: "general error",
        0x08000020: "data cannot be stored",
        0x08000021: "local control",
        DEVICE_STATE: "not in the present device state",
    }
)
"""Words for the abort codes of CiA 301, table 22."""

Transfer = Generator[bytes, bytes, bytes]
"""Yields requests, is sent replies, returns the data (empty for a download)."""


class SdoAbort(Exception):
    """A transfer was aborted with `code`."""

    def __init__(self, index: int, sub: int, code: int) -> None:
        super().__init__(f"{index:#06x}:{sub} aborted with {code:#010x}: {ABORTS.get(code, 'unknown reason')}")
        self.index, self.sub, self.code = index, sub, code


def abort(index: int, sub: int, code: int) -> bytes:
    """The message that ends a transfer, from either side."""
    return bytes([0x80]) + _address(index, sub) + code.to_bytes(4, "little")


def belongs(request: bytes, reply: bytes) -> bool:
    """Whether `reply` can be the answer to `request`: same kind of transfer, same object, same toggle bit."""
    if len(reply) != 8:
        return False
    asked, said = request[0] >> 5, reply[0] >> 5
    if said == 4:
        return asked in (0, 3) or reply[1:4] == request[1:4]
    if asked in (1, 2):
        return said == {1: 3, 2: 2}[asked] and reply[1:4] == request[1:4]
    return said == {0: 1, 3: 0}[asked] and (reply[0] ^ request[0]) & 0x10 == 0


def upload(index: int, sub: int) -> Transfer:
    """Read one object. Raises SdoAbort."""
    reply = yield bytes([0x40]) + _address(index, sub) + bytes(4)
    _check(reply, index, sub)
    if reply[0] & 0x02:
        return reply[4 : 8 - ((reply[0] >> 2) & 3 if reply[0] & 0x01 else 0)]
    size = int.from_bytes(reply[4:8], "little") if reply[0] & 0x01 else None
    data, toggle = b"", 0
    while True:
        reply = yield bytes([0x60 | toggle]) + bytes(7)
        _check(reply, index, sub)
        data += reply[1 : 8 - ((reply[0] >> 1) & 7)]
        toggle ^= 0x10
        if reply[0] & 0x01:
            break
    if size is not None and len(data) != size:
        raise SdoAbort(index, sub, LENGTH)
    return data


def download(index: int, sub: int, data: bytes) -> Transfer:
    """Write one object: expedited up to 4 bytes, else in segments. Raises SdoAbort."""
    if 1 <= len(data) <= 4:
        command = 0x23 | (4 - len(data)) << 2
        _check((yield bytes([command]) + _address(index, sub) + data.ljust(4, b"\0")), index, sub)
        return b""
    _check((yield bytes([0x21]) + _address(index, sub) + len(data).to_bytes(4, "little")), index, sub)
    toggle = 0
    for start in range(0, max(len(data), 1), 7):
        part = data[start : start + 7]
        command = toggle | (7 - len(part)) << 1 | (start + 7 >= len(data))
        _check((yield bytes([command]) + part.ljust(7, b"\0")), index, sub)
        toggle ^= 0x10
    return b""


def _address(index: int, sub: int) -> bytes:
    return index.to_bytes(2, "little") + bytes([sub])


def _check(reply: bytes, index: int, sub: int) -> None:
    if reply[0] >> 5 == 4:
        raise SdoAbort(index, sub, int.from_bytes(reply[4:8], "little"))


class SdoServer:
    """The other side: answers requests with what `read` gives and hands to `write` what came; both raise SdoAbort."""

    def __init__(self, read: Callable[[int, int], bytes], write: Callable[[int, int, bytes], None]) -> None:
        self._read, self._write = read, write
        self._at = (0, 0)
        self._data = b""
        self._toggle = 0
        self._kind = ""

    def answer(self, request: bytes) -> bytes | None:
        """The reply to one request; None to an abort, which is not answered."""
        if len(request) != 8:
            return None
        command = request[0] >> 5
        if command in (1, 2):
            self._at = (int.from_bytes(request[1:3], "little"), request[3])
        try:
            match command:
                case 2:
                    return self._start_upload()
                case 3:
                    return self._upload_segment(request)
                case 1:
                    return self._start_download(request)
                case 0:
                    return self._download_segment(request)
                case 4:
                    self._kind = ""
                    return None
            raise SdoAbort(*self._at, UNKNOWN_COMMAND)
        except SdoAbort as error:
            self._kind = ""
            return abort(*self._at, error.code)

    def _start_upload(self) -> bytes:
        data = self._read(*self._at)
        if 1 <= len(data) <= 4:
            return bytes([0x43 | (4 - len(data)) << 2]) + _address(*self._at) + data.ljust(4, b"\0")
        self._kind, self._data, self._toggle = "upload", data, 0
        return bytes([0x41]) + _address(*self._at) + len(data).to_bytes(4, "little")

    def _upload_segment(self, request: bytes) -> bytes:
        self._expect("upload", request)
        part, self._data = self._data[:7], self._data[7:]
        command = (request[0] & 0x10) | (7 - len(part)) << 1 | (not self._data)
        return bytes([command]) + part.ljust(7, b"\0")

    def _start_download(self, request: bytes) -> bytes:
        if request[0] & 0x02:
            self._write(*self._at, request[4 : 8 - ((request[0] >> 2) & 3 if request[0] & 0x01 else 0)])
        else:
            self._kind, self._data, self._toggle = "download", b"", 0
        return bytes([0x60]) + _address(*self._at) + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        self._expect("download", request)
        self._data += request[1 : 8 - ((request[0] >> 1) & 7)]
        if request[0] & 0x01:
            self._kind = ""
            self._write(*self._at, self._data)
        return bytes([0x20 | request[0] & 0x10]) + bytes(7)

    def _expect(self, kind: str, request: bytes) -> None:
        if self._kind != kind:
            raise SdoAbort(*self._at, UNKNOWN_COMMAND)
        if request[0] & 0x10 != self._toggle:
            raise SdoAbort(*self._at, TOGGLE)
        self._toggle ^= 0x10
