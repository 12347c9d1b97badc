"""One run as the controller sees it: something to prepare, execute and close, whatever came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from cellctl.ports import Checkpoint, Progress

Verdict = Literal["accepted", "rejected", "held"]
Ending = Literal["complete", "held", "stopped", "aborted"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to by itself. `held`: it cannot go on without a person; reasons are sentences."""

    verdict: Verdict
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RunEnd:
    """How a run ended: the cell's declared condition, and the verdict if there is one."""

    ending: Ending
    outcome: Outcome


class Session(Protocol):
    """One execution of one job order. `close` is called exactly once, by the controller, after all else."""

    @property
    def run_id(self) -> str: ...
    @property
    def job_order_id(self) -> str: ...
    async def prepare(self) -> None:
        """State Starting: freeze the recipe, dry run, open the journal. Raises where the run must not begin."""
        ...

    async def execute(self, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        """State Execute: the phases, then the verdict."""
        ...

    async def close(self, end: RunEnd) -> None:
        """Write the end, close the journal, seal the record. Devices are safe or at rest by now."""
        ...


class SafeReport(Protocol):
    """What `make_safe` read back."""

    @property
    def safe(self) -> bool: ...
    @property
    def unsafe(self) -> dict[str, str]:
        """Name of each device that is not proven safe, with the reason."""
        ...


class SafeCell(Protocol):
    """What the controller needs of the cell's devices."""

    async def make_safe(self, deadline_s: float) -> SafeReport: ...
    async def rearm(self) -> None: ...
