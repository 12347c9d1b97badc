"""How long a run will still take, from how long its dry run took. Pure."""

from __future__ import annotations

from collections.abc import Sequence


def time_left_s(phases_s: Sequence[tuple[str, float]], phase: str, fraction: float) -> float | None:
    """Cell seconds to the end of the run; None where the phase is not among those of the dry run.

    `phases_s` are the phases of the dry run in their order with their cell time in seconds.
    """
    names = [name for name, _ in phases_s]
    if phase not in names:
        return None
    at = names.index(phase)
    rest = sum(seconds for _, seconds in phases_s[at + 1 :])
    return phases_s[at][1] * (1.0 - min(max(fraction, 0.0), 1.0)) + rest
