"""Ring of force samples in memory that two processes share: one writes, others read, nobody waits.

Each slot carries its sample's number, its time, its force and a check word over all three. A reader takes a slot only
where number and check are right, so that a slot which is being written over, or is torn, is noticed, whatever the order
in which another processor sees the writes.
"""

from __future__ import annotations

import mmap
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SLOTS = 4096
"""Samples that are kept; 4 s at 1 kHz."""
_HEAD = np.dtype([("magic", "<u8"), ("next", "<u8"), ("period_s", "<f8"), ("range_n", "<f8")])
_SLOT = np.dtype([("number", "<u8"), ("time_s", "<f8"), ("force_n", "<f8"), ("check", "<u8")])
_PACKED, _FLOATS, _BITS, _NEXT = struct.Struct("<QddQ"), struct.Struct("<dd"), struct.Struct("<QQ"), struct.Struct("<Q")
_NEXT_AT = 8
_MAGIC = 0x31474E49525F4643
SIZE = _HEAD.itemsize + SLOTS * _SLOT.itemsize


class RingError(ValueError):
    """The file is no ring."""


class RingWriter:
    """Makes the file `path` anew, readable by its user only."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.unlink(missing_ok=True)  # a reader of the one before keeps what it has
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            os.ftruncate(file, SIZE)
            self._memory = mmap.mmap(file, SIZE)
        finally:
            os.close(file)
        slots, head = np.frombuffer(self._memory, _SLOT, SLOTS, _HEAD.itemsize), np.frombuffer(self._memory, _HEAD, 1)
        slots["check"] = 1  # the zeros of a slot never written are no sample 0
        head["magic"] = _MAGIC

    def put(self, first: int, times_s: NDArray[np.float64], forces_n: NDArray[np.float64]) -> None:
        """Samples `first` and following; numbers never go back."""
        samples = zip(range(first, first + len(forces_n)), times_s.tolist(), forces_n.tolist(), strict=True)
        for number, time_s, force_n in samples:
            time_bits, force_bits = _BITS.unpack(_FLOATS.pack(time_s, force_n))
            at = _HEAD.itemsize + number % SLOTS * _SLOT.itemsize
            _PACKED.pack_into(self._memory, at, number, time_s, force_n, number ^ time_bits ^ force_bits)
        _NEXT.pack_into(self._memory, _NEXT_AT, first + len(forces_n))

    def close(self) -> None:
        """Take the file away; readers keep what they have."""
        self._memory.close()
        self.path.unlink(missing_ok=True)


class RingReader:
    """Raises OSError where there is no file, RingError where it is no ring."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            try:
                self._memory = mmap.mmap(file.fileno(), SIZE, access=mmap.ACCESS_READ)
            except ValueError as error:
                raise RingError(f"{path}: {error}") from None
        self._head = np.frombuffer(self._memory, _HEAD, 1)
        self._slots = np.frombuffer(self._memory, _SLOT, SLOTS, _HEAD.itemsize)
        if int(self._head["magic"][0]) != _MAGIC:
            self.close()
            raise RingError(f"{path} is no ring of samples")

    @property
    def next(self) -> int:
        """Number of the next sample to come."""
        return int(self._head["next"][0])

    def take(self, first: int, count: int) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
        """Up to `count` consecutive samples from the first one still there at or after `first`: its number, times,
        forces; empty where none has come. A gap in the numbering ends what is taken."""
        first = max(first, self.next - SLOTS)
        while first < (last := min(first + count, self.next)):
            numbers = np.arange(first, last, dtype=np.uint64)
            entry = self._slots[(numbers % SLOTS).astype(np.intp)].copy()
            good = (entry["number"] == numbers) & (entry["check"] == _check(entry))
            if good[0]:
                whole = len(good) if good.all() else int(np.argmin(good))
                return first, entry["time_s"][:whole], entry["force_n"][:whole]
            first += int(np.argmax(good)) if good.any() else len(good)
        return first, np.empty(0), np.empty(0)

    def close(self) -> None:
        """Let go of the memory."""
        del self._slots, self._head
        self._memory.close()


def _check(entry: NDArray[np.void]) -> NDArray[np.uint64]:
    times, forces = np.ascontiguousarray(entry["time_s"]), np.ascontiguousarray(entry["force_n"])
    numbers: NDArray[np.uint64] = entry["number"]
    found: NDArray[np.uint64] = np.bitwise_xor(numbers, times.view(np.uint64) ^ forces.view(np.uint64))
    return found
