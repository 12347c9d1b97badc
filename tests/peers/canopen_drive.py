"""A drive on the PyPI package canopen: its LocalNode answers SDO, NMT, heartbeat and PDO mapping; only the behaviour
of the axis is written here, from the words of CiA 402 and without this repository's codecs.

Objects are named by numbers on purpose: a codec shared by both sides would hide its own errors.
"""

from __future__ import annotations

import threading
import time
from typing import Any

import canopen
from canopen.objectdictionary import ODRecord, ODVariable

I8, I16, I32, U8, U16, U32, TEXT = 2, 3, 4, 5, 6, 7, 9
OBJECTS: dict[tuple[int, int], tuple[int, int | str]] = {
    (0x1000, 0): (U32, 0x00020192),
    (0x1001, 0): (U8, 0),
    (0x1008, 0): (TEXT, "A drive with a long name"),
    (0x100A, 0): (TEXT, "7.1"),
    (0x1016, 1): (U32, 0),
    (0x1017, 0): (U16, 0),
    **{(0x1018, sub): (U32, value) for sub, value in ((1, 0x123), (2, 0x456), (3, 7), (4, 4711))},
    (0x1029, 1): (U8, 0),
    **{(0x6000 + low, 0): (I16, 0) for low in (0x07, 0x5A, 0x5E)},
    **{(0x6000 + low, 0): (U16, 0) for low in (0x3F, 0x40, 0x41)},
    **{(0x6000 + low, 0): (I8, 1) for low in (0x60, 0x61, 0x98)},
    **{(0x6000 + low, 0): (I32, 0) for low in (0x64, 0x6C, 0x7A)},
    **{(0x6000 + low, 0): (U32, 1) for low in (0x65, 0x80, 0x81, 0x83, 0x84, 0x85, 0x9A)},
    (0x607D, 1): (I32, 0),
    (0x607D, 2): (I32, 0),
    (0x608F, 1): (U32, 10_000),
    **{(index, sub): (U32, 1) for index in (0x608F, 0x6091, 0x6092, 0x6099) for sub in (1, 2) if index != 0x608F},
    (0x608F, 2): (U32, 1),
    (0x6092, 1): (U32, 100_000),
    (0x60FE, 1): (U32, 0),
}
MOVES_S = 0.3


def dictionary(node: int) -> Any:
    """The object dictionary, PDO parameters included."""
    objects = dict(OBJECTS)
    for index, cob in ((0x1400, 0x200), (0x1401, 0x300), (0x1800, 0x180), (0x1801, 0x280)):
        objects |= {(index, 1): (U32, 0x80000000 + cob + node), (index, 2): (U8, 255), (index, 5): (U16, 0)}
        objects |= {(index + 0x200, sub): (U32 if sub else U8, 0) for sub in range(9)}
    made = canopen.ObjectDictionary()
    records = {index for index, sub in objects if sub}
    for index in sorted(records):
        record = ODRecord(f"record {index:#x}", index)
        if (index, 0) not in objects:
            objects[index, 0] = (U8, max(sub for at, sub in objects if at == index))
        made.add_object(record)
    for (index, sub), (kind, value) in objects.items():
        variable = ODVariable(f"object {index:#x} {sub}", index, sub)
        variable.data_type, variable.default, variable.access_type = kind, value, "rw"
        if index in records:
            made[index].add_member(variable)
        else:
            made.add_object(variable)
    return made


class PeerDrive:
    """The axis behind a LocalNode: motions take `MOVES_S`; a quick stop stays in quick stop."""

    def __init__(self, network: Any, number: int) -> None:
        self.node = network.create_node(number, dictionary(number))
        self._lock = threading.RLock()
        self._network, self._number = network, number
        self._bits = 0x0250
        self._word = 0
        self._acknowledged = False
        self._from, self._to, self._began = 0, 0, 0.0
        self._travelling = False
        self._homed = False
        self.starts = 0
        self.node.add_read_callback(self._read)
        self.node.add_write_callback(self._written)
        network.subscribe(0, self._nmt)
        self.node.nmt.state = "PRE-OPERATIONAL"

    def _position(self) -> int:
        if not self._travelling:
            return self._to
        share = min((time.monotonic() - self._began) / MOVES_S, 1.0)
        return round(self._from + share * (self._to - self._from))

    def _read(self, *, index: int, subindex: int, od: Any) -> int | None:
        with self._lock:
            if self._travelling and time.monotonic() - self._began >= MOVES_S:
                self._travelling = False
                if self._mode() == 6:
                    self._homed = self._acknowledged = True
            match index:
                case 0x6041:
                    reached = 0 if self._travelling else 0x400
                    return self._bits | reached | 0x1000 * self._acknowledged | 0x8000 * self._homed
                case 0x6061:
                    return self._mode()
                case 0x6064:
                    return self._position()
                case 0x606C:
                    return round((self._to - self._from) / MOVES_S) if self._travelling else 0
        return None

    def _mode(self) -> int:
        data = self.node.data_store.get(0x6060, {}).get(0, b"\x01")
        return int.from_bytes(data, "little", signed=True)

    def _written(self, *, index: int, subindex: int, od: Any, data: bytes) -> None:
        if index == 0x6040:
            with self._lock:
                self._control(int.from_bytes(data, "little"))

    def _control(self, word: int) -> None:
        before, self._word = self._word, word
        operating = self._bits & 0x6F == 0x27
        if word & 0x0F == 0x06:
            self._bits = 0x0231
        elif word & 0x0F == 0x07:
            self._bits = 0x0233
        elif word & 0x0F == 0x0F and self._bits & 0x6F in (0x23, 0x27, 0x07):
            self._bits = 0x0237
        elif word & 0x06 == 0x02 and operating:
            self._bits = 0x0217
            self._from = self._to = self._position()
            self._travelling = False
        if self._bits & 0x6F != 0x27:
            return
        if word & 0x10 and not before & 0x10:
            self.starts += 1
            homing = self._mode() == 6
            target = self.node.data_store.get(0x607A, {}).get(0, bytes(4))
            self._from, self._began = self._position(), time.monotonic()
            self._to = 0 if homing else int.from_bytes(target, "little", signed=True)
            self._travelling, self._acknowledged = True, not homing
        elif not word & 0x10 and self._mode() == 1:
            self._acknowledged = False

    def _nmt(self, can_id: int, data: bytes, timestamp: float) -> None:
        if data[0] == 1:
            self.node.rpdo.read()
            for one in self.node.rpdo.values():
                one.add_callback(self._received)

    def _received(self, pdo: Any) -> None:
        for variable in sorted(pdo, key=lambda one: one.index, reverse=True):  # the mode before the controlword
            self.node.set_data(variable.index, variable.subindex, bytes(variable.get_data()))
