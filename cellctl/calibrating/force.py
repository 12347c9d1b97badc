"""Gain and offset of the force sensor, from weights that hang on it. Pure.

Each weight is read twice at the same height, arrived at from below and from above, so that the guides' friction cancels
in the mean. reading = offset + force / gain, a straight line over the forces of the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellctl.vision.geometry import Array
from cellctl.vision.part import Refused
from hal.units import GRAVITY_M_S2

LEAST_WEIGHTS, LEAST_SHARE = 3, 0.3
WORST_LINEARITY = 0.005
GAINS = (0.5, 2.0)
KNOWN_UNITS = {"kilograms": 1.0 / GRAVITY_M_S2, "kilonewton": 1e-3, "pounds": 0.2248089, "the other sign": -1.0}
"""What a sensor that reads in another unit says for each newton."""


@dataclass(frozen=True, slots=True)
class Weighed:
    """Mean readings (N) under one mass, arrived at from below and from above; `noise_n` is one sigma of a sample."""

    mass_kg: float
    up_n: float
    down_n: float
    noise_n: float

    @property
    def reading_n(self) -> float:
        """Without friction."""
        return 0.5 * (self.up_n + self.down_n)


@dataclass(frozen=True, slots=True)
class Force:
    """True force = gain x (reading - offset). `covariance` (2, 2) of gain and offset; `linearity` the largest residual
    as a share of the range; `friction_n` half the difference of up and down; `noise_n` of one sample."""

    gain: float
    offset_n: float
    covariance: Array
    linearity: float
    friction_n: float
    noise_n: float


def force_gain(weighed: Sequence[Weighed], *, range_n: float, mass_sigma: float) -> Force:
    """From three weights and more; `mass_sigma` is their relative uncertainty, which they share.

    Raises Refused geometry_too_weak, wrong_unit, residual_too_large.
    """
    force = np.array([one.mass_kg for one in weighed]) * GRAVITY_M_S2
    reading = np.array([one.reading_n for one in weighed])
    _require(weighed, force, range_n)
    matrix = np.column_stack([np.ones_like(force), force])
    (offset, slope), *_ = np.linalg.lstsq(matrix, reading, rcond=None)
    if not GAINS[0] <= slope <= GAINS[1]:
        near = [name for name, one in KNOWN_UNITS.items() if abs(slope / one - 1.0) < 0.25]
        hint = f": it seems to read {near[0]}" if near else ""
        raise Refused(
            "wrong_unit", f"the sensor gives {slope:.4g} for each newton (limits {GAINS[0]} to {GAINS[1]}){hint}"
        )
    rest = reading - matrix @ np.array([offset, slope])
    worst = float(np.abs(rest).max())
    if worst > WORST_LINEARITY * range_n:
        heaviest = weighed[int(np.argmax(np.abs(rest)))].mass_kg
        raise Refused(
            "residual_too_large",
            f"with {heaviest:g} kg the sensor is {worst:.1f} N off the line (limit {WORST_LINEARITY * range_n:.1f} N): "
            "wrong weight, or something touches",
        )
    gain = 1.0 / float(slope)
    return Force(
        gain=gain,
        offset_n=float(offset),
        covariance=_covariance(matrix, rest, gain, mass_sigma),
        linearity=worst / range_n,
        friction_n=float(np.mean([0.5 * (one.up_n - one.down_n) for one in weighed])),
        noise_n=float(np.sqrt(np.mean([one.noise_n**2 for one in weighed]))),
    )


def _require(weighed: Sequence[Weighed], force: Array, range_n: float) -> None:
    if not all(np.isfinite([one.reading_n, one.noise_n]).all() for one in weighed):
        raise Refused("not_measurable", "the sensor gave a reading that is no number")
    different = len(np.unique(force))
    if different < LEAST_WEIGHTS or np.ptp(force) < LEAST_SHARE * range_n:
        raise Refused(
            "geometry_too_weak",
            f"{different} weights over {np.ptp(force):.0f} N; at least {LEAST_WEIGHTS} over {LEAST_SHARE:.0%} of the "
            f"range ({range_n:.0f} N) are needed",
        )
    for one in weighed:
        if max(abs(one.up_n), abs(one.down_n)) > 0.999 * range_n:
            raise Refused("out_of_range", f"with {one.mass_kg:g} kg the sensor is at its limit ({range_n:.0f} N)")


def _covariance(matrix: Array, rest: Array, gain: float, mass_sigma: float) -> Array:
    """(2, 2) of gain and offset: scatter (as Student's distribution has it), a curve that the line hides, the masses.

    A sensor that curves is read on a chord of that curve: the largest residual over half the span is what the slope may
    be off elsewhere.
    """
    free = len(rest) - 2
    variance = float(rest @ rest) / free * (free / (free - 2) if free > 2 else 3.0)
    line = variance * np.linalg.inv(matrix.T @ matrix)
    worst, span = float(np.abs(rest).max()), float(np.ptp(matrix[:, 1]))
    line += np.diag([worst**2, (2.0 * worst / span) ** 2])
    to_gain = np.array([[0.0, -(gain**2)], [1.0, 0.0]])
    covariance = to_gain @ line @ to_gain.T
    covariance[0, 0] += (gain * mass_sigma) ** 2
    return np.asarray(covariance)
