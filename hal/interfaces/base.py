"""What every device can do, and the readings that many give."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol


class Quality(StrEnum):
    """Whether a reading may be used."""

    GOOD = "good"
    UNCERTAIN = "uncertain"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a device says it is. `simulated` is true for every fake and simulator."""

    vendor: str
    model: str
    serial: str
    firmware: str
    simulated: bool


@dataclass(frozen=True, slots=True)
class Reading:
    """One value in the unit that the device's interface states."""

    value: float
    time_s: float
    quality: Quality = Quality.GOOD


@dataclass(frozen=True, slots=True)
class SafeState:
    """Read-back of the safe state; `detail` is one sentence for the operator."""

    safe: bool
    detail: str


class Device(Protocol):
    """What every device can do."""

    @property
    def name(self) -> str: ...
    async def connect(self) -> Identity: ...
    async def close(self) -> None: ...
    async def halt(self) -> None: ...
    async def safe(self) -> SafeState: ...
    async def rearm(self) -> None: ...
