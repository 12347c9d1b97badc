"""Values in 16-bit registers: scaled numbers, floats, bits, text; and blocks of registers for one exchange. Pure.

Every field knows its place (`at`, counted from the start of its device's registers), its size, and both directions.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

T = TypeVar("T")
WordOrder = Literal["high_first", "low_first"]


class RegisterError(ValueError):
    """A value that does not fit its registers, or registers that hold no such value; names place, reason, limit."""


class RegisterField(Protocol[T]):
    """One value in `size` registers from `at` on."""

    @property
    def name(self) -> str: ...
    @property
    def at(self) -> int: ...
    @property
    def size(self) -> int: ...
    def decode(self, words: Sequence[int]) -> T: ...
    def encode(self, value: T) -> tuple[int, ...]: ...


@dataclass(frozen=True, slots=True)
class Scaled:
    """A number as an integer in steps of 1/`per_unit`; beyond `low` and `high` it is not believed."""

    name: str
    at: int
    per_unit: int = 1
    signed: bool = False
    low: float = -math.inf
    high: float = math.inf

    @property
    def size(self) -> int:
        return 1

    def decode(self, words: Sequence[int]) -> float:
        raw = words[0] - 0x10000 if self.signed and words[0] >= 0x8000 else words[0]
        return self._within(raw / self.per_unit)

    def encode(self, value: float) -> tuple[int, ...]:
        lowest, highest = (-0x8000, 0x7FFF) if self.signed else (0, 0xFFFF)
        if not lowest <= self._within(value) * self.per_unit <= highest:
            limits = f"limit {lowest / self.per_unit:g} to {highest / self.per_unit:g}"
            raise RegisterError(f"{_place(self)}: {value} does not fit ({limits})")
        return (round(value * self.per_unit) & 0xFFFF,)

    def _within(self, value: float) -> float:
        if not self.low <= value <= self.high:
            raise RegisterError(f"{_place(self)}: {value} is out of range (limit {self.low:g} to {self.high:g})")
        return value


@dataclass(frozen=True, slots=True)
class Float:
    """IEEE 754 binary32 in two registers; which word comes first differs from vendor to vendor."""

    name: str
    at: int
    order: WordOrder = "high_first"

    @property
    def size(self) -> int:
        return 2

    def decode(self, words: Sequence[int]) -> float:
        high, low = words if self.order == "high_first" else (words[1], words[0])
        return float(struct.unpack(">f", struct.pack(">HH", high, low))[0])

    def encode(self, value: float) -> tuple[int, ...]:
        try:
            high, low = struct.unpack(">HH", struct.pack(">f", value))
        except OverflowError:
            raise RegisterError(f"{_place(self)}: {value} does not fit (limit 3.4e38)") from None
        return (high, low) if self.order == "high_first" else (low, high)


@dataclass(frozen=True, slots=True)
class Bits:
    """Named bits of one register, the lowest first; bits without a name are ignored."""

    name: str
    at: int
    bits: tuple[str, ...]

    @property
    def size(self) -> int:
        return 1

    def decode(self, words: Sequence[int]) -> frozenset[str]:
        return frozenset(bit for place, bit in enumerate(self.bits) if words[0] >> place & 1)

    def encode(self, value: frozenset[str]) -> tuple[int, ...]:
        if unknown := value.difference(self.bits):
            raise RegisterError(f"{_place(self)}: no bit {sorted(unknown)} (bits {', '.join(self.bits)})")
        return (sum(1 << self.bits.index(bit) for bit in value),)


@dataclass(frozen=True, slots=True)
class Text:
    """UTF-8 text, two bytes a register, the high byte first, filled up with NUL."""

    name: str
    at: int
    size: int

    def decode(self, words: Sequence[int]) -> str:
        raw = struct.pack(f">{self.size}H", *words)
        try:
            return raw.rstrip(b"\0 ").decode("utf-8")
        except UnicodeDecodeError as error:
            raise RegisterError(f"{_place(self)}: no text: {raw.hex(' ')} ({error.reason})") from None

    def encode(self, value: str) -> tuple[int, ...]:
        raw = value.encode("utf-8")
        if len(raw) > 2 * self.size or "\0" in value:
            raise RegisterError(f"{_place(self)}: {value!r} does not fit (limit {2 * self.size} bytes, no NUL)")
        return struct.unpack(f">{self.size}H", raw.ljust(2 * self.size, b"\0"))


@dataclass(frozen=True, slots=True)
class Image:
    """Registers of one device as they were read, from `start` on."""

    start: int
    words: tuple[int, ...]

    def __getitem__(self, field: RegisterField[T]) -> T:
        """The value of a field. Raises RegisterError where it was not read or holds no such value."""
        begin = field.at - self.start
        if begin < 0 or begin + field.size > len(self.words):
            raise RegisterError(
                f"{_place(field)}: not among registers {self.start} to {self.start + len(self.words) - 1}"
            )
        return field.decode(self.words[begin : begin + field.size])


@dataclass(frozen=True, slots=True)
class Block:
    """`fields` that follow each other without gaps and are read, or written, in one exchange."""

    fields: tuple[RegisterField[Any], ...]

    def __post_init__(self) -> None:
        end = self.start
        for field in self.fields:
            if field.at != end:
                raise RegisterError(f"{_place(field)}: must begin at register {end}, where the field before it ends")
            end += field.size

    @property
    def start(self) -> int:
        return self.fields[0].at

    @property
    def size(self) -> int:
        return sum(field.size for field in self.fields)

    def image(self, words: Sequence[int]) -> Image:
        """Registers read for this block. Raises RegisterError where their number is another."""
        if len(words) != self.size:
            raise RegisterError(f"registers {self.start}: {len(words)} came, {self.size} were asked for")
        return Image(self.start, tuple(words))

    def encode(self, values: Mapping[RegisterField[Any], Any]) -> tuple[int, ...]:
        """Registers that say `values`, one for every field of the block."""
        return tuple(word for field in self.fields for word in field.encode(values[field]))


def _place(field: RegisterField[Any]) -> str:
    return f"{field.name} at register {field.at}"
