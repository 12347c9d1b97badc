"""What an error that leaves a run means for the cell: hold it, or abort it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cellctl.ports import RunHeld
from cellctl.vision.part import Refused
from hal.errors import CellError, SafetyError

INTERNAL_ERROR = "internal_error"


@dataclass(frozen=True, slots=True)
class Failure:
    """`code` is stable, `reason` one sentence. `reaction` is the least that the cell must do."""

    reaction: Literal["hold", "abort"]
    code: str
    reason: str


def failure_of(error: Exception) -> Failure:
    """Safety conditions abort; what a device, a gate or the vision core says holds; anything unforeseen aborts."""
    if isinstance(error, SafetyError):
        return Failure("abort", error.code, str(error))
    if isinstance(error, CellError):
        return Failure("hold", error.code, str(error))
    if isinstance(error, RunHeld | Refused):
        return Failure("hold", error.code, error.reason)
    return Failure("abort", INTERNAL_ERROR, f"{type(error).__name__}: {error}")
