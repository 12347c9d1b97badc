"""The best pose of two parts that are only so well known: where to aim, and how far the true best may lie from there.

Pure. The best pose leaves the worst bolt the most clearance. Which bolt is the worst is itself uncertain, and so the
best pose of the true parts scatters by more than the mean of the bolts does.
"""

from __future__ import annotations

import numpy as np

from cellctl.kinematics import Array
from cellctl.vision.match import polish
from cellctl.vision.uncertainty import Belief

SAMPLES = 64
SHARP_MM = 5e-4
"""Softness at which a best pose counts as exact: far below what any measurement knows."""


def softness_mm(belief: Belief) -> float:
    """How far two bolts must differ in clearance to be told apart, for `polish`.

    The expected largest of terms that are each uncertain by a Gumbel error of scale s is s log sum exp(. / s) exactly
    (McFadden 1974); s = sqrt(6) / pi times one sigma of a bolt's own offset.
    """
    return float(np.sqrt(6.0) / np.pi * np.sqrt(np.mean(np.sum(belief.own_mm**2, axis=2))))


def aim(belief: Belief, difference_k: float) -> Array:
    """(3,) motion (x mm, y mm, turn rad) to the pose that serves the worst bolt, cold and at `difference_k`."""
    cold = belief.offsets_mm.reshape(-1, 2)
    hot = cold + difference_k * np.tile(belief.growth_mm_per_k, (len(belief.offsets_mm), 1))
    times = 2 * len(belief.offsets_mm)
    return polish(
        np.concatenate([cold, hot]),
        np.tile(belief.jacobian, (times, 1, 1)),
        np.tile(belief.clearance_mm, times),
        softness_mm=max(softness_mm(belief), 1e-6),
    )


def type_a(belief: Belief, measured: Array, generator: np.random.Generator) -> Array:
    """(3, 3) covariance of (x mm, y mm, turn rad) of the present pose about the best cold pose of the true parts.

    `measured` (n, 2, k) are the causes that all bolts share and that come from the measurement itself. Mean square
    over `SAMPLES` draws of what the bolts may be, so what the pose gives away for the sake of the hot joint counts too.
    """
    stations, count, kinds = belief.own_mm.shape
    own = _pairs(generator, (kinds, count, 2))
    shared = _pairs(generator, (measured.shape[2],))
    offsets = belief.offsets_mm + np.einsum("iak,bk->bia", measured, shared)[:, None]
    offsets = offsets + np.einsum("sik,bkia->bsia", belief.own_mm, own)
    best = polish(
        offsets.reshape(SAMPLES, -1, 2),
        np.tile(belief.jacobian, (stations, 1, 1)),
        np.tile(belief.clearance_mm, stations),
        softness_mm=SHARP_MM,
    )
    return np.asarray(best.T @ best / SAMPLES)


def _pairs(generator: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """(SAMPLES, ...) standard normal numbers, each with its negative."""
    draw = generator.standard_normal((SAMPLES // 2, *shape))
    return np.concatenate([draw, -draw])
