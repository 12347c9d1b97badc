"""What the steps are given. Each port has one implementation for production and may have another for tests."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import Calibration
from cellctl.docking import Alignment, AlignSpec
from cellctl.kinematics import AxesPosition
from cellctl.recipe import Recipe
from cellctl.vision.part import Part, PartMeasurement
from hal.interfaces import (
    Axis,
    CameraPark,
    Chuck,
    ForceBlock,
    ForceSensor,
    Frame,
    GapProbe,
    GuardLimits,
    GuardState,
    Gun,
    Heater,
    NutFeeder,
    PartStation,
    SafetyInputs,
    Scanner,
    Thermometer,
)

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
    `resume` makes it ready to go on. With `ask` the run suspends itself here: a person does what it says and confirms
    by unsuspend.
    """

    async def __call__(
        self,
        retreat: Callable[[], Awaitable[None]] | None = None,
        resume: Callable[[], Awaitable[None]] | None = None,
        *,
        ask: str = "",
    ) -> None: ...


class Interlock(Protocol):
    """Arms and disarms the force guard; the guard itself stops the axes and latches."""

    async def arm(self, limits: GuardLimits) -> None: ...
    async def disarm(self) -> GuardState:
        """Disarm and return what the guard saw; `tripped` stays latched until `rearm`."""
        ...

    async def rearm(self) -> None:
        """Clear the latch after a trip."""
        ...

    def state(self) -> GuardState: ...
    async def window(self, seconds: float) -> ForceBlock: ...


class Vision(Protocol):
    """The vision core behind a worker: raises `cellctl.vision.part.Refused`, never returns a doubtful pose."""

    async def measure(self, frame: Frame, part: Part) -> PartMeasurement:
        """One part in the cell frame."""
        ...

    async def artefact(self, frame: Frame) -> NDArray[np.float64]:
        """Residuals (n, 3) in mm of the artefact's sphere centres, measured minus certified, cell frame."""
        ...

    async def align(
        self, rotor: PartMeasurement, shaft: PartMeasurement, measured_at: AxesPosition, spec: AlignSpec
    ) -> Alignment:
        """Where the shaft has to go; `measured_at` is where the axes stood when the shaft was scanned."""
        ...


class Devices(Protocol):
    """The devices that a run uses, by the names of the cell file."""

    @property
    def stage_x(self) -> Axis: ...
    @property
    def stage_y(self) -> Axis: ...
    @property
    def jack(self) -> Axis: ...
    @property
    def shaft_table(self) -> Axis: ...
    @property
    def gun_table(self) -> Axis: ...
    @property
    def gun_feed(self) -> Axis: ...
    @property
    def gun_a(self) -> Gun: ...
    @property
    def gun_b(self) -> Gun: ...
    @property
    def gun_force_a(self) -> ForceSensor: ...
    @property
    def gun_force_b(self) -> ForceSensor: ...
    @property
    def spigot_tc_1(self) -> Thermometer: ...
    @property
    def spigot_tc_2(self) -> Thermometer: ...
    @property
    def pyrometer(self) -> Thermometer: ...
    @property
    def rotor_tc(self) -> Thermometer: ...
    @property
    def heater(self) -> Heater: ...
    @property
    def chuck(self) -> Chuck: ...
    @property
    def camera_park(self) -> CameraPark: ...
    @property
    def nut_feeder(self) -> NutFeeder: ...
    @property
    def gap_probe_1(self) -> GapProbe: ...
    @property
    def gap_probe_2(self) -> GapProbe: ...
    @property
    def gap_probe_3(self) -> GapProbe: ...
    @property
    def safety(self) -> SafetyInputs: ...
    @property
    def part_station(self) -> PartStation: ...
    @property
    def scanner(self) -> Scanner: ...


@dataclass(frozen=True, slots=True)
class GuardPlan:
    """What the composition root worked out for the force guard from recipe and cell file.

    `insert_trip_n` leaves room for the overshoot, so that the force stays below the recipe's limit.
    """

    insert_trip_n: float
    stale_ms: float
    contact_block: int


@dataclass(frozen=True, slots=True)
class RunContext:
    """Everything that the steps of one run are given."""

    devices: Devices
    recipe: Recipe
    calibration: Calibration
    guard_plan: GuardPlan
    ledger: Ledger
    progress: Progress
    checkpoint: Checkpoint
    interlock: Interlock
    vision: Vision
    rotor_serial: str
    shaft_serial: str


class RunHeld(Exception):
    """The run cannot go on by itself: `code` is stable, `reason` is one sentence for the operator."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(f"{code}: {reason}")
        self.code = code
        self.reason = reason
