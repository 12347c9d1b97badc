"""CANopen (CiA 301): identifiers, network management, heartbeat, emergency, objects as typed entries, PDO layouts."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from hal.codec.lawicel import CanFrame

NMT, SYNC, EMCY = 0x000, 0x080, 0x080
TPDO1, RPDO1, TPDO2, RPDO2 = 0x180, 0x200, 0x280, 0x300
SDO_REPLY, SDO_REQUEST, HEARTBEAT = 0x580, 0x600, 0x700
"""Function codes: the node's number is added to each but NMT and SYNC (predefined connection set, 7.3.3)."""


class NmtState(IntEnum):
    """What a heartbeat says."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class NmtCommand(IntEnum):
    """What the master asks for."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class Malformed(ValueError):
    """Bytes that are not what their identifier promises; the text names place and reason."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One object: index, sub-index and its type as a `struct` code (b B h H i I)."""

    index: int
    sub: int
    code: str
    name: str

    def __str__(self) -> str:
        return f"{self.name} ({self.index:#06x}:{self.sub})"

    @property
    def size(self) -> int:
        """Bytes."""
        return struct.calcsize(f"<{self.code}")

    @property
    def mapping(self) -> int:
        """As a PDO mapping entry: index, sub-index and length in bits (7.5.2.36)."""
        return self.index << 16 | self.sub << 8 | 8 * self.size

    def encode(self, value: int) -> bytes:
        """Little endian. Raises Malformed where the value does not fit."""
        try:
            return struct.pack(f"<{self.code}", value)
        except struct.error as error:
            raise Malformed(f"{self}: {value} does not fit: {error}") from None

    def decode(self, data: bytes) -> int:
        """Raises Malformed where the length is another."""
        if len(data) != self.size:
            raise Malformed(f"{self}: {len(data)} bytes, expected {self.size}")
        return int(struct.unpack(f"<{self.code}", data)[0])


DEVICE_TYPE = Entry(0x1000, 0, "I", "device type")
ERROR_REGISTER = Entry(0x1001, 0, "B", "error register")
CONSUMER_HEARTBEAT = Entry(0x1016, 1, "I", "consumer heartbeat time")
PRODUCER_HEARTBEAT = Entry(0x1017, 0, "H", "producer heartbeat time")
VENDOR = Entry(0x1018, 1, "I", "vendor")
PRODUCT = Entry(0x1018, 2, "I", "product code")
REVISION = Entry(0x1018, 3, "I", "revision")
SERIAL = Entry(0x1018, 4, "I", "serial number")
ERROR_BEHAVIOUR = Entry(0x1029, 1, "B", "error behaviour on lost communication")
NO_VENDOR = 0
"""A vendor number that is nobody's: simulators."""
ERROR_BEHAVIOUR_STAY = 1
"""Of 0x1029: no change of the NMT state, so that the drive goes on reporting."""


def nmt(command: NmtCommand, node: int) -> CanFrame:
    """A command to `node`; 0 is all."""
    return CanFrame(NMT, bytes([command, node]))


def heartbeat(node: int, state: NmtState = NmtState.OPERATIONAL) -> CanFrame:
    """One beat of `node`."""
    return CanFrame(HEARTBEAT + node, bytes([state]))


def heartbeat_state(data: bytes) -> NmtState:
    """What a heartbeat's data says. Raises Malformed."""
    if len(data) != 1:
        raise Malformed(f"heartbeat: {len(data)} bytes, expected 1")
    try:
        return NmtState(data[0] & 0x7F)
    except ValueError:
        raise Malformed(f"heartbeat: unknown state {data[0]:#04x}") from None


def consumer_heartbeat(node: int, time_ms: int) -> int:
    """Value of 0x1016: whose beat is expected and how often at least (7.5.2.18)."""
    return node << 16 | time_ms


@dataclass(frozen=True, slots=True)
class Emergency:
    """An EMCY object: error code, error register, 5 bytes of the vendor's own. Code 0 is "no error"."""

    code: int
    register: int
    vendor: bytes = bytes(5)

    def encode(self) -> bytes:
        """8 bytes."""
        return struct.pack("<HB5s", self.code, self.register, self.vendor)

    @classmethod
    def decode(cls, data: bytes) -> Emergency:
        """Raises Malformed."""
        if len(data) != 8:
            raise Malformed(f"emergency: {len(data)} bytes, expected 8")
        return cls(*struct.unpack("<HB5s", data))


def pdo_cob(function: int, node: int) -> tuple[Entry, int]:
    """The communication parameter's COB-ID entry of one of the four PDOs, and its value."""
    return Entry(_PARAMETERS[function], 1, "I", f"COB-ID of PDO {function:#05x}"), function + node


def pdo_mapping(function: int) -> int:
    """Index of the mapping parameter of one of the four PDOs."""
    return _PARAMETERS[function] + 0x200


_PARAMETERS = MappingProxyType({RPDO1: 0x1400, RPDO2: 0x1401, TPDO1: 0x1800, TPDO2: 0x1801})
PDO_OFF = 0x80000000
"""Bit of the COB-ID entry: the PDO does not exist."""
ON_CHANGE = 255
"""Transmission type: sent by the device's own events and its event timer."""


def pack(layout: Sequence[Entry], values: Mapping[Entry, int]) -> bytes:
    """The data of a PDO with `layout`."""
    return b"".join(entry.encode(values[entry]) for entry in layout)


def unpack(layout: Sequence[Entry], data: bytes) -> dict[Entry, int]:
    """Values by entry. Raises Malformed where the data is not exactly as long as the layout."""
    if len(data) != (size := sum(entry.size for entry in layout)):
        raise Malformed(f"PDO: {len(data)} bytes, expected {size}")
    values, at = {}, 0
    for entry in layout:
        values[entry] = entry.decode(data[at : at + entry.size])
        at += entry.size
    return values
