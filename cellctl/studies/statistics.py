"""Rates with their intervals. Pure."""

from __future__ import annotations

import math


def wilson(successes: int, runs: int, *, z: float = 1.959963984540054) -> tuple[float, float]:
    """Two-sided 95 % interval of a rate (Wilson score, E. B. Wilson 1927); (0, 1) for no runs."""
    if runs == 0:
        return 0.0, 1.0
    p = successes / runs
    middle = p + z * z / (2 * runs)
    half = z * math.sqrt(p * (1 - p) / runs + z * z / (4 * runs * runs))
    scale = 1 + z * z / runs
    # At the ends the closed form leaves a rounding error where the bound is exact.
    low = (middle - half) / scale if successes else 0.0
    return low, (middle + half) / scale if successes < runs else 1.0


def quantile(values: list[float], q: float) -> float:
    """Nearest-rank quantile; 0 for no values."""
    if not values:
        return 0.0
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, math.ceil(q * len(ordered)) - 1))]
