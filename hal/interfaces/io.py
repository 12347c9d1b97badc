"""Chuck, camera arm, nut feeder, gap probes, safety circuit, part station."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from hal.interfaces.base import Device, Reading


@dataclass(frozen=True, slots=True)
class ChuckState:
    """Two independent feedbacks; `clamped` only if both say so and the pressure holds."""

    clamped_1: bool
    clamped_2: bool
    pressure_bar: float
    time_s: float


class Chuck(Device, Protocol):
    """Holds the shaft against turning and tilting."""

    async def read(self) -> ChuckState: ...
    async def clamp(self) -> ChuckState: ...
    async def release(self) -> ChuckState: ...


@dataclass(frozen=True, slots=True)
class ParkState:
    """Where the camera arm is; `position` is None while it moves or when the two feedbacks disagree."""

    position: Literal["parked", "rotor", "shaft"] | None
    time_s: float


class CameraPark(Device, Protocol):
    """The arm that brings the camera into its two views and parks it."""

    async def read(self) -> ParkState: ...
    async def go(self, position: Literal["parked", "rotor", "shaft"]) -> ParkState: ...


class NutFeeder(Device, Protocol):
    """Puts one nut from the magazine into a gun's socket."""

    async def count(self) -> int: ...
    async def load(self, gun: Literal["a", "b"]) -> bool:
        """Load one nut; true when the presence sensor sees it in the socket."""
        ...


class GapProbe(Device, Protocol):
    """Distance between the two faces at one place, millimetres."""

    async def read(self) -> Reading: ...


@dataclass(frozen=True, slots=True)
class SafetyState:
    """Mirror of the hard-wired circuit; None means unknown, and unknown counts as tripped."""

    estop_released: bool | None
    guards_closed: bool | None
    sto_released: bool | None
    bench_locked: bool | None
    bench_moved: bool | None
    time_s: float

    @property
    def ok(self) -> bool:
        """Whether motion may be asked for."""
        return (
            self.estop_released is True
            and self.guards_closed is True
            and self.sto_released is True
            and self.bench_locked is True
            and self.bench_moved is False
        )


class SafetyInputs(Device, Protocol):
    """Read-only mirror of e-stop, guards, STO and bench lock."""

    async def read(self) -> SafetyState: ...


class PartStation(Device, Protocol):
    """Presents the parts of an order and reads their serial numbers back (code reader or operator)."""

    async def present(self, rotor: str, shaft: str) -> tuple[str, str]:
        """Ask for the two parts; returns the serial numbers that were read on them."""
        ...
