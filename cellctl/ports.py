"""What the steps are given. Each port has one implementation for production and may have another for tests."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Part, PartMeasurement
from hal.interfaces import ForceBlock, Frame, GuardLimits, GuardState

R = TypeVar("R")


class Ledger(Protocol):
    """The one place where anything that acts is written down: intent, command, result, acknowledge.

    A write that cannot be made durable raises, and the command is then not sent.
    """

    async def act(
        self, device: str, command: str, arguments: Mapping[str, object], do: Callable[[str], Awaitable[R]]
    ) -> R:
        """Journal the intent under a new key, await `do(key)`, journal what came of it (result or error)."""
        ...

    async def note(self, kind: str, value: object) -> None:
        """Journal a fact: a step's frozen result, a decision, a hold."""
        ...

    async def blob(self, kind: str, arrays: Mapping[str, NDArray[Any]]) -> str:
        """Store arrays (cloud, trace, force curve) by content hash, journal the hash and return it."""
        ...


class Progress(Protocol):
    """Where the run is, for people. Never awaited, never fails."""

    def report(self, phase: str, fraction: float, text: str) -> None: ...


class Checkpoint(Protocol):
    """A place where the run may be held. Returns at once unless a hold was asked for.

    On a hold, `retreat` brings the phase into its declared holding condition, the run waits for unhold, then
    `resume` makes it ready to go on.
    """

    async def __call__(
        self,
        retreat: Callable[[], Awaitable[None]] | None = None,
        resume: Callable[[], Awaitable[None]] | None = None,
    ) -> None: ...


class Interlock(Protocol):
    """Arms and disarms the force guard; the guard itself stops the axes."""

    async def arm(self, limits: GuardLimits) -> None: ...
    async def disarm(self) -> GuardState:
        """Disarm and return what the guard saw. Raises GuardTripped when it latched meanwhile."""
        ...

    async def rearm(self) -> None:
        """Clear the latch after a trip and make every set-point the measured value."""
        ...

    async def window(self, seconds: float) -> ForceBlock: ...


class Vision(Protocol):
    """The vision core behind a worker: raises `cellctl.vision.part.Refused`, never returns a doubtful pose."""

    async def measure(self, frame: Frame, part: Part) -> PartMeasurement:
        """One part in the cell frame."""
        ...

    async def artefact(self, frame: Frame) -> NDArray[np.float64]:
        """Residuals (n, 3) in mm of the artefact's sphere centres, measured minus certified, cell frame."""
        ...
