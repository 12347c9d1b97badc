"""Force sensors, and the guard that watches one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hal.interfaces.base import Device


@dataclass(frozen=True, slots=True)
class ForceBlock:
    """Consecutive samples of one sensor, raw (weight included), newton, compression positive.

    `sequence` numbers the first sample since connect; sample i was taken at `time_s + i * period_s`.
    """

    sequence: int
    time_s: float
    period_s: float
    samples_n: NDArray[np.float64]


class ForceSensor(Device, Protocol):
    """A streaming force sensor. It has one reader: the jack's is read by the guard alone."""

    @property
    def rate_hz(self) -> float: ...
    @property
    def range_n(self) -> float: ...
    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        """The next `count` samples; returns when the last of them was taken.

        It ends early with the first sample that is not within [low_n, high_n] (raw newton; NaN never is), so that
        a reader reacts to one sample and need not be woken for each.
        """
        ...


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """What the guard lets pass while armed: net force (raw minus tare) within [low_n, trip_n], sample age below
    `stale_ms`. `block` is the number of samples that it looks at in one go."""

    label: str
    tare_n: float
    trip_n: float
    low_n: float
    stale_ms: float
    block: int


@dataclass(frozen=True, slots=True)
class GuardState:
    """`tripped` latches until `rearm`. Peak and last are net forces since the last arm, newton."""

    armed: bool
    tripped: bool
    reason: str
    peak_n: float
    last_n: float
    samples: int
    time_s: float


class ForceGuard(Protocol):
    """The only reader of the jack's force sensor; halts every force-producing axis on a trip and latches.

    Known here so that the cell can build it in the loop or as a client of the guard process.
    """

    async def arm(self, limits: GuardLimits) -> None: ...
    async def disarm(self) -> GuardState: ...
    async def rearm(self) -> None: ...
    def state(self) -> GuardState: ...
    async def window(self, seconds: float) -> ForceBlock:
        """The samples of the next `seconds`, read while nothing else is asked of the sensor's owner."""
        ...
