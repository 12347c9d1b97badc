"""How noise along the ray grows as a surface is seen more at a slant: learnt from the residuals of a fit. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.thread_surface import LEAD_IN, TIP, Array, Depths

LEAST_COSINE = 0.05
UNEVEN = 0.03
"""What a surface departs from its form, as a share of the noise: it bounds what a ray that grazes can tell."""
MIN_SIGMA_MM = 1e-5
CLASSES = 12
SURE_GROWTH, NO_GROWTH = 0.5, 0.2
"""From the first on growth counts as 1: the points that graze decide most of a fit, which makes their residuals look
small, and too little weight on them costs less than too much. Below the second it counts as 0."""
CLEAR_COSINE = 0.26
"""Nearer to grazing, a flank's edge may be taken for a crest, and fits by chance."""
LEAST_IN_CLASS = 20


@dataclass(frozen=True, slots=True)
class NoiseLaw:
    """One sigma of a depth: `scale_mm` over cosine of incidence to `growth`; times `lead_in` on the lead-in.

    `growth` is 0 where a camera's noise along the ray is the same everywhere, 1 where it is the same across the
    surface.
    """

    scale_mm: float
    growth: float = 1.0
    lead_in: float = 1.0

    def sigmas(self, met: Depths) -> Array:
        """One sigma (N,) in mm."""
        cosine = np.maximum(met.cosine, LEAST_COSINE)
        slant = 1.0 / cosine if self.growth == 1.0 else cosine**-self.growth if self.growth else 1.0
        spread = self.scale_mm * np.sqrt(slant * slant + np.square(UNEVEN / met.cosine))
        return np.asarray(
            spread if self.lead_in == 1.0 else np.where(met.surface == LEAD_IN, spread * self.lead_in, spread)
        )


def on_thread(met: Depths, pitch_mm: float) -> NDArray[np.bool_]:
    """Points (N,) on thread or lead-in. The root below half a pitch, whose form no standard fixes, is left out."""
    on = (met.surface < TIP) & np.isfinite(met.ahead_mm)
    return np.asarray(on & ((met.surface == LEAD_IN) | (met.below_mm < 0.5 * pitch_mm)))


def tukey(met: Depths, law: NoiseLaw, pitch_mm: float) -> tuple[Array, Array]:
    """Robust weights (N,) and one sigma (N,) of each depth; weight 0 for what is no thread."""
    sigmas = law.sigmas(met)
    ratio = np.abs(np.nan_to_num(met.ahead_mm)) / (4.7 * sigmas)
    return np.where(on_thread(met, pitch_mm), np.square(1.0 - np.square(np.minimum(ratio, 1.0))), 0.0), sigmas


def misfit(met: Depths, law: NoiseLaw, pitch_mm: float) -> Array:
    """Tukey's loss (N,) of each point, 0 to 1; 1 for what is no thread."""
    weights, _ = tukey(met, law, pitch_mm)
    return np.asarray(1.0 - weights * np.sqrt(weights))


def scale_of(met: Depths, law: NoiseLaw, pitch_mm: float, least_mm: float) -> NoiseLaw:
    """The law with the scale that the residuals show, or `least_mm` where that is larger (while converging)."""
    unit = NoiseLaw(1.0, law.growth, law.lead_in)
    ratio = (np.abs(met.ahead_mm) / unit.sigmas(met))[on_thread(met, pitch_mm)]
    near = ratio[ratio < max(6.0 * least_mm, 0.3)]
    spread = 1.4826 * float(np.median(near)) if len(near) > 5 else 0.03
    return NoiseLaw(max(spread, least_mm, MIN_SIGMA_MM), law.growth, law.lead_in)


def learn(met: Depths, law: NoiseLaw, pitch_mm: float) -> NoiseLaw:
    """The law from the residuals at hand: median residual over cosine in classes of equal size, then the scales.

    The lead-in counts for less where it is not the cone that it is taken for.
    """
    weights, _ = tukey(met, law, pitch_mm)
    rows = np.flatnonzero((weights > 0.0) & (met.cosine > CLEAR_COSINE))
    growth = law.growth
    if len(rows) >= 4 * LEAST_IN_CLASS:
        x, y = [], []
        order = rows[np.argsort(met.cosine[rows], kind="stable")]
        for few in np.array_split(order, min(CLASSES, len(rows) // LEAST_IN_CLASS)):
            x.append(float(np.mean(np.log(np.maximum(met.cosine[few], LEAST_COSINE)))))
            y.append(float(np.log(np.median(np.abs(met.ahead_mm[few])) + MIN_SIGMA_MM)))
        if np.ptp(x) > 0.2:
            centred = np.array(x) - np.mean(x)
            growth = -float(centred @ np.array(y)) / float(centred @ centred)
            growth = 1.0 if growth > SURE_GROWTH else (growth if growth > NO_GROWTH else 0.0)
    steady = scale_of(met, NoiseLaw(law.scale_mm, growth), pitch_mm, 0.0)
    sigmas = steady.sigmas(met)
    ends = np.flatnonzero((met.surface == LEAD_IN) & (np.abs(met.ahead_mm) < 10.0 * sigmas))
    if len(ends) < LEAST_IN_CLASS:
        return steady
    wide = 1.4826 * float(np.median(np.abs(met.ahead_mm[ends]) / sigmas[ends]))
    return NoiseLaw(steady.scale_mm, growth, max(1.0, wide) if wide > 1.25 else 1.0)
