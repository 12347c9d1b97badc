"""What a gun's own controller remembers, whoever is connected: spindle, socket, running program, results by key."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from hal.fake.joints.tightening import Run
from hal.interfaces import TighteningProgram, TighteningResult

GunName = Literal["a", "b"]


@dataclass(frozen=True, slots=True)
class ActiveRun:
    """A program under way. `joint` is None where the socket holds nothing; `free_deg` is turned before the hex fits."""

    key: str
    program: TighteningProgram
    run: Run
    joint: int | None
    free_deg: float
    start_s: float
    feigned: bool = False
    """The transducer lies: OK is reported whatever was met."""

    @property
    def end_s(self) -> float:
        """When it ends by itself."""
        return self.start_s + self.run.duration_s


@dataclass(slots=True)
class GunMemory:
    """One gun. `spindle_deg` counts positive in the sense of tightening."""

    name: GunName
    spindle_deg: float = 0.0
    nut_in_socket: bool = False
    reversed_on_stud: bool = False
    """The nut was turned backwards on the stud's end, so that its thread lies ready."""
    active: ActiveRun | None = None
    keys: set[str] = field(default_factory=set)
    results: dict[str, TighteningResult] = field(default_factory=dict)
    last: TighteningResult | None = None
    tightening_id: int = 0

    @property
    def serial(self) -> str:
        """Serial number of the controller."""
        return f"gun-{self.name}-1"
