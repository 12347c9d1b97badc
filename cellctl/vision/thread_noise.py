"""How noise along the ray grows as a surface is seen more at a slant: learnt from the residuals of a fit. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import median, robust_sigma
from cellctl.vision.thread_surface import LEAD_IN, PITCH, RADIUS, ROOT, ROOT_RADIUS, TIP, Array, Depths

LEAST_COSINE = 0.05
UNEVEN = 0.03
"""What a surface departs from its form, as a share of the noise: it bounds what a ray that grazes can tell."""
MIN_SIGMA_MM = 1e-5
CLASSES = 12
SURE_GROWTH, NO_GROWTH = 0.5, 0.2
"""From the first on growth counts as 1: the points that graze decide most of a fit, which makes their residuals look
small, and too little weight on them costs less than too much. Below the second it counts as 0."""
CLEARLY = 3.0
"""Standard deviations by which growth must differ from 1 or 0 to count as something else."""
CLEAR_COSINE = 0.26
"""Nearer to grazing, a flank's edge may be taken for a crest, and fits by chance."""
LEAST_IN_CLASS = 20
MUCH_WIDER = 1.25
SURELY_FLANK = 0.5
"""Depth in pitches down to which every thread's flanks are straight."""


@dataclass(frozen=True, slots=True)
class NoiseLaw:
    """One sigma of a depth: `scale_mm` over cosine of incidence to `growth`; times `lead_in`, `root` on these.

    `growth` is 0 where a camera's noise along the ray is the same everywhere, 1 where it is the same across the
    surface. Flanks deeper than `deepest_mm` below the crest are left out: a root may be rounded. `least_mm` is the
    noise that the face shows: a fit to a few points takes up what they share, and its residuals look too small.
    """

    scale_mm: float
    deepest_mm: float
    growth: float = 1.0
    lead_in: float = 1.0
    root: float = 1.0
    least_mm: float = MIN_SIGMA_MM

    def sigmas(self, met: Depths) -> Array:
        """One sigma (N,) in mm."""
        cosine = np.maximum(met.cosine, LEAST_COSINE)
        slant = 1.0 / cosine if self.growth == 1.0 else cosine**-self.growth if self.growth else 1.0
        spread = self.scale_mm * np.sqrt(slant * slant + np.square(UNEVEN / met.cosine))
        for surface, factor in ((LEAD_IN, self.lead_in), (ROOT, self.root)):
            if factor != 1.0:
                spread = np.where(met.surface == surface, spread * factor, spread)
        return np.asarray(spread)


def on_thread(met: Depths, deepest_mm: float) -> NDArray[np.bool_]:
    """Points (N,) on thread or lead-in."""
    on = (met.surface < TIP) & np.isfinite(met.ahead_mm)
    return np.asarray(on & ((met.surface >= ROOT) | (met.below_mm < deepest_mm)))


def tukey(met: Depths, law: NoiseLaw) -> tuple[Array, Array]:
    """Robust weights (N,) and one sigma (N,) of each depth; weight 0 for what is no thread."""
    sigmas = law.sigmas(met)
    ratio = np.where(on_thread(met, law.deepest_mm), met.ahead_mm, np.inf) * (1.0 / 4.7)
    ratio /= sigmas
    return np.square(1.0 - np.minimum(ratio * ratio, 1.0)), sigmas


def misfit(met: Depths, law: NoiseLaw) -> Array:
    """Tukey's loss (N,) of each point, 0 to 1; 1 for what is no thread."""
    weights, _ = tukey(met, law)
    return np.asarray(1.0 - weights * np.sqrt(weights))


def scale_of(met: Depths, law: NoiseLaw, least_mm: float) -> NoiseLaw:
    """The law with the scale that the residuals show, or `least_mm` where that is larger (while converging)."""
    unit = replace(law, scale_mm=1.0)
    ratio = (np.abs(met.ahead_mm) / unit.sigmas(met))[on_thread(met, law.deepest_mm)]
    near = ratio[ratio < max(6.0 * least_mm, 0.3)]
    spread = robust_sigma(near) if len(near) > 5 else 0.03
    return replace(law, scale_mm=max(spread, least_mm, law.least_mm))


def learn(met: Depths, law: NoiseLaw, shared: Array) -> NoiseLaw:
    """The law from the residuals at hand: median residual over cosine in classes of equal size, then the scales.

    The lead-in and the root count for less where they are not the cone and the cylinder that they are taken for.
    """
    weights, _ = tukey(met, law)
    rows = np.flatnonzero((weights > 0.0) & (met.cosine > CLEAR_COSINE) & (met.surface != ROOT))
    growth = law.growth
    if len(rows) >= 4 * LEAST_IN_CLASS:
        growth = _growth(met, rows)
    plain = NoiseLaw(law.scale_mm, SURELY_FLANK * shared[PITCH], growth, least_mm=law.least_mm)
    steady = scale_of(met, plain, 0.0)
    sigmas = steady.sigmas(met)
    lead_in, root = _factor(met, sigmas, LEAD_IN), _factor(met, sigmas, ROOT)
    deepest = steady.deepest_mm
    if root == 1.0:
        deepest = max(deepest, 0.97 * float(shared[RADIUS] - shared[ROOT_RADIUS]))
    return replace(steady, lead_in=lead_in or 1.0, root=root or 1.0, deepest_mm=deepest)


def _growth(met: Depths, rows: NDArray[np.intp]) -> float:
    """How the residuals of some points grow with the slant: the slope of their logarithms over classes of cosine."""
    parts = min(CLASSES, len(rows) // LEAST_IN_CLASS)
    x, y = np.empty(parts), np.empty(parts)
    order = rows[np.argsort(met.cosine[rows], kind="stable")]
    for k, few in enumerate(np.array_split(order, parts)):
        x[k] = np.mean(np.log(np.maximum(met.cosine[few], LEAST_COSINE)))
        y[k] = np.log(median(np.abs(met.ahead_mm[few])) + MIN_SIGMA_MM)
    arm = x - x.mean()
    spread = float(np.sqrt(np.sum(arm * arm)))
    if spread == 0.0:
        return 1.0
    growth = -float(np.sum(arm * y)) / spread**2
    # the logarithm of a median of n normal values scatters by 1.17 / sqrt(n)
    sigma = 1.17 / np.sqrt(len(rows) / parts) / spread
    if growth > min(SURE_GROWTH, 1.0 - CLEARLY * sigma):
        return 1.0
    return growth if growth > max(NO_GROWTH, CLEARLY * sigma) else 0.0


def _factor(met: Depths, sigmas: Array, surface: int) -> float:
    """How many times wider than `sigmas` (N,) the residuals on one surface scatter; 1 where little, 0 if not seen."""
    rows = np.flatnonzero((met.surface == surface) & (np.abs(met.ahead_mm) < 10.0 * sigmas))
    if len(rows) < LEAST_IN_CLASS:
        return 0.0
    wide = robust_sigma(met.ahead_mm[rows] / sigmas[rows])
    return wide if wide > MUCH_WIDER else 1.0
