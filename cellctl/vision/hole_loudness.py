"""How loud face, chamfer and wall of holes are against each other, where neighbouring pixels share noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array
from cellctl.vision.hole_fit import LEAST_COSINE, HoleFits, slant_power
from cellctl.vision.hole_model import FACE, Samples, facing, residuals
from cellctl.vision.plane import TUKEY
from cellctl.vision.shared_noise import SharedNoise, correlated

LEAST_SHOWN = 0.1  # of the noise's variance that a residual must still show to be asked for the noise
LEAST_POINTS = 90
THINNED = 300  # points of a hole that tell as much as all of them
NORMAL_MEDIAN = 0.6745


def amplitude_mm(fits: HoleFits, labels: NDArray[np.int8], cosine: Array) -> Array:
    """Noise (M,) in mm across the surface of each point, negative where the error that lifts the face is."""
    side = np.where(labels == FACE, -1.0, 1.0)
    return np.asarray(side * fits.sigma_mm[labels] * np.maximum(cosine, LEAST_COSINE) ** fits.slant_power)


def as_loud_as_it_is(
    samples: Samples, fits: HoleFits, labels: NDArray[np.int8], noise: SharedNoise, pixels: Array
) -> HoleFits:
    """`fits` with the scales and the slant power of the noise before the fit took its part of it.

    Nine parameters follow most of what the few patches of a coarse picture share, on one surface more than on another;
    residuals alone would tell how loud face, chamfer and wall are against each other, on which the refinement rests,
    wrong by a quarter. In a fine picture every other pixel, or fewer, tells as much.
    """
    step = max(1, int(np.sqrt(len(labels) / (THINNED * (len(samples.starts) - 1)))))
    row, column = pixels.astype(np.intp).T % step
    some = np.flatnonzero((row == 0) & (column == 0))
    samples, labels, pixels = samples.take(some), labels[some], pixels[some] / step
    noise = SharedNoise(noise.length_px / step, noise.share)
    value, design = residuals(samples, fits.parameters, labels)
    cosine = facing(samples, fits.parameters, labels)
    amplitude = amplitude_mm(fits, labels, cosine)
    used = (labels >= 0) & (np.abs(value) < TUKEY * np.abs(amplitude))
    shown = _shown(samples, fits, design * used * step / amplitude, noise, pixels)
    asked = used & (shown > LEAST_SHOWN)
    alone = np.abs(value) / np.sqrt(np.maximum(shown, LEAST_SHOWN))
    power = slant_power(labels, alone, asked.astype(np.float64), cosine)
    alone /= np.maximum(cosine, LEAST_COSINE) ** power
    scales = [float(np.median(alone[asked & (labels == kind)])) / NORMAL_MEDIAN
              if np.count_nonzero(asked & (labels == kind)) >= LEAST_POINTS else fits.sigma_mm[kind]
              for kind in range(3)]  # fmt: skip
    return replace(fits, sigma_mm=np.array(scales), slant_power=power)


def _shown(samples: Samples, fits: HoleFits, design: Array, noise: SharedNoise, pixels: Array) -> Array:
    """(M,) share of each point's variance that is left in the residuals of the first fit, which took noise for white.

    The diagonal of (1 - H) R (1 - H)^T for the hat matrix H of `design` (9, M), rows over their noise, and the
    correlation R of the noise.
    """
    shown = np.ones(design.shape[1])
    for k, (a, b) in enumerate(zip(samples.starts[:-1], samples.starts[1:], strict=True)):
        if b > a:
            own = design[:, a:b]
            hat = np.linalg.solve(own @ own.T + np.diag(fits.prior[k] * fits.inflation), own)
            seen = correlated(own.T, pixels[a:b], noise)
            shown[a:b] += np.einsum("im,im->m", hat, (own @ seen) @ hat - 2.0 * seen.T)
    return shown
