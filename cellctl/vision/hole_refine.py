"""Holes again, freed from the noise that neighbouring pixels share (generalised least squares).

Structured light decodes depth over a neighbourhood, so what the face shows beside a hole says what the error of the
chamfer next to it is: it moves a point of the face down where it moves a point of chamfer or wall outward.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array, robust_sigma
from cellctl.vision.hole_fit import HoleFits, normal_equations
from cellctl.vision.hole_loudness import amplitude_mm, as_loud_as_it_is
from cellctl.vision.hole_model import CHAMFER, CU, CV, FACE, SIZE, WALL, Samples, facing, label, residuals
from cellctl.vision.plane import TUKEY
from cellctl.vision.shared_noise import SharedNoise, correlated
from cellctl.vision.stencil import Stencil

RING_LENGTHS = 1.5  # width of the ring of face that is used, in correlation lengths
ROUNDS = 4
LEAST_WHITE = 0.02
ROUGHER = 0.9
MODEL_FLOOR = 0.06  # of the noise: what the model of shapes and noise leaves out stays in the centre


def refine(samples: Samples, fits: HoleFits, noise: SharedNoise, pixels: Array, pitch_mm: float) -> HoleFits:
    """Parameters and covariances of `fits` refined. `pixels` (M, 2) belong to the samples, `pitch_mm` is their size."""
    parameters = fits.parameters.copy()
    labels = label(samples, parameters, fits.sigma_mm)
    fits = as_loud_as_it_is(samples, fits, labels, noise, pixels)
    rows = _near(samples, fits, labels, RING_LENGTHS * noise.length_px * pitch_mm)
    samples, labels, pixels = samples.take(rows), labels[rows], pixels[rows]
    amplitude = amplitude_mm(fits, labels, facing(samples, parameters, labels))
    white = SharedNoise(noise.length_px, min(noise.share, 1.0 - LEAST_WHITE))
    stencil = Stencil.of(pixels.astype(np.intp), samples.owner, white.at)
    value, design = residuals(samples, parameters, labels)
    free = stencil.apply(np.concatenate([design, value[None]]) / amplitude)
    for _ in range(ROUNDS):
        spread = max(robust_sigma(free[SIZE]), 1e-3)
        ratio = free[SIZE] / (TUKEY * spread)
        # quieter than the model of the noise does not count for more: what all neighbours share is as large as before
        weights = np.where(np.abs(ratio) < 1.0, np.square(1.0 - ratio * ratio), 0.0) / max(spread, 1.0) ** 2
        normal, gradient = normal_equations(samples.starts, free[:SIZE], weights, free[SIZE])
        inverse = np.linalg.inv(normal + fits.prior[:, :, None] * np.eye(SIZE))
        pull = gradient + fits.prior * (parameters - fits.prior_mean)
        step = -np.clip(np.einsum("kij,kj->ki", inverse, pull), -0.1, 0.1)
        parameters += step
        free[SIZE] += np.einsum("pm,pm->m", free[:SIZE], samples.each(step.T))  # over microns the surfaces are flat
        if not samples.chamfered:
            parameters[:, CHAMFER] = parameters[:, WALL]
    influence = stencil.back(free[:SIZE] * weights)
    covariances = fits.covariances.copy()
    for k, (a, b) in enumerate(zip(samples.starts[:-1], samples.starts[1:], strict=True)):
        if b > a:
            largest = float(np.abs(amplitude[a:b]).max())
            own = influence[:, a:b].T
            covariances[k] = _sandwich(own, pixels[a:b], noise, inverse[k], fits.prior[k], largest)
    return replace(fits, parameters=parameters, covariances=covariances)


def _sandwich(
    influence: Array, pixels: Array, noise: SharedNoise, inverse: Array, prior: Array, amplitude_mm: float
) -> Array:
    """Covariance (9, 9) of the estimate under the noise as it is, not as the stencil approximates it.

    How smooth the noise is, is only known so well, and the gain rests on it: it is taken a little rougher than found.
    """
    rougher = SharedNoise(ROUGHER * noise.length_px, noise.share - min(noise.share, 1.0 - ROUGHER) * 0.1)
    scatter = influence.T @ correlated(influence, pixels, rougher) + np.diag(prior)
    covariance = np.asarray(inverse @ scatter @ inverse)
    covariance[[CU, CV], [CU, CV]] += (MODEL_FLOOR * amplitude_mm) ** 2
    return covariance


def _near(samples: Samples, fits: HoleFits, labels: NDArray[np.int8], ring_mm: float) -> NDArray[np.intp]:
    """Points that are no outliers and lie in the hole or in the ring of face about it, by index."""
    value, _ = residuals(samples, fits.parameters, labels)
    cu, cv, mouth = samples.each(fits.parameters[:, [CU, CV, CHAMFER]].T)
    square = np.square(samples.points[:, 0] - cu) + np.square(samples.points[:, 1] - cv)
    fits_in = (labels >= 0) & (np.abs(value) < TUKEY * fits.sigma_mm[labels])
    return np.flatnonzero(fits_in & ((labels != FACE) | (square < np.square(mouth + ring_mm))))
