"""A cloud small enough for a page: the features whole, the rest sampled, four whole numbers a point. Pure."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.residuals import NONE, SURFACES, Residuals

FEATURE_SHARE = 0.7
"""Share of the budget that points in and at features may take."""
RESIDUAL_STEP_MM = 1e-4
NO_RESIDUAL = -32768


@dataclass(frozen=True, slots=True)
class PackedCloud:
    """`points`: base64 of little-endian int16 (n, 4): x, y, z in `step_mm`, then the residual or NO_RESIDUAL.

    `surfaces`: base64 of uint8 (n,), a place in SURFACES or, for points on none of them, one behind it.
    """

    count: int
    step_mm: float
    points: str
    surfaces: str


def chosen(seen: Residuals, budget: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """At most `budget` points, in their order: those of the features up to their share, the rest drawn at random."""
    if len(seen.surface) <= budget:
        return np.arange(len(seen.surface))
    at_feature = seen.feature >= 0
    dense, thin = np.flatnonzero(at_feature), np.flatnonzero(~at_feature)
    kept = min(len(dense), max(int(FEATURE_SHARE * budget), budget - len(thin)))
    sampled = rng.choice(thin, min(len(thin), budget - kept), replace=False, shuffle=False)
    return np.sort(np.concatenate([rng.choice(dense, kept, replace=False, shuffle=False), sampled]))


def packed(seen: Residuals, rows: NDArray[np.intp]) -> PackedCloud:
    """The chosen points. A step is a 32767th of the largest coordinate; longer residuals end at 3.2767 mm."""
    local = seen.local_mm[rows]
    step = max(float(np.abs(local).max(initial=0.0)), 1.0) / 32767.0
    numbers = np.empty((len(rows), 4), dtype="<i2")
    numbers[:, :3] = np.rint(local / step)
    off = np.rint(seen.distance_mm[rows].astype(np.float64) / RESIDUAL_STEP_MM)
    numbers[:, 3] = np.where(np.isfinite(off), np.clip(np.nan_to_num(off), -32767, 32767), NO_RESIDUAL)
    surfaces = np.where(seen.surface[rows] == NONE, len(SURFACES), seen.surface[rows]).astype(np.uint8)
    return PackedCloud(len(rows), step, _text(numbers.tobytes()), _text(surfaces.tobytes()))


def _text(data: bytes) -> str:
    return b64encode(data).decode("ascii")
