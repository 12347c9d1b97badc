"""Holes again, with the noise that neighbouring pixels share estimated beside them (generalised least squares).

Each hole's parameters and a smooth field of depth error are solved together; the error moves a point of the face
down where it moves a point of chamfer or wall outward.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cellctl.vision.geometry import Array
from cellctl.vision.hole_fit import LEAST_COSINE, HoleFits
from cellctl.vision.hole_model import CHAMFER, CU, CV, FACE, SIZE, TILT_U, WALL, Samples, facing, label, residuals
from cellctl.vision.plane import TUKEY, robust_sigma
from cellctl.vision.shared_noise import SharedNoise, correlated, field_basis

RING_LENGTHS = 1.5  # width of the ring of face that is used, in correlation lengths
ROUNDS = 3
LEAST_WHITE = 0.02
ROUGHER = 0.9
MODEL_FLOOR = 0.06  # of the noise: what the model of shapes and noise leaves out stays in the centre


@dataclass(frozen=True, slots=True)
class _Hole:
    """Points of one hole: indices among the samples, surfaces, pixels (m, 2), signed noise (m,), field (m, p)."""

    index: NDArray[np.intp]
    labels: NDArray[np.int8]
    pixels: Array
    amplitude: Array
    field: Array


def refine(samples: Samples, fits: HoleFits, noise: SharedNoise, pixels: Array, pitch_mm: float) -> HoleFits:
    """Parameters and covariances of `fits` refined. `pixels` (M, 2) belong to the samples, `pitch_mm` is their size."""
    parameters = fits.parameters.copy()
    labels = label(samples, parameters, fits.sigma_mm)
    value, _ = residuals(samples, parameters, labels)
    count = len(parameters)
    near = _near(samples, parameters, labels, value, fits.sigma_mm, RING_LENGTHS * noise.length_px * pitch_mm)
    cosine = np.maximum(facing(samples, parameters, labels), LEAST_COSINE)
    amplitude = fits.sigma_mm[np.maximum(labels, 0)] * cosine**fits.slant_power * np.where(labels == FACE, -1.0, 1.0)
    holes = [_hole(samples, k, near, labels, pixels, noise, amplitude) for k in range(count)]
    prior = fits.prior
    scale = fits.sigma_mm * np.sqrt(max(1.0 - noise.share, LEAST_WHITE))
    left: list[Array] = [np.zeros(0)] * count
    covariances = fits.covariances.copy()
    free = 0.0
    for step in range(ROUNDS):
        value, design = residuals(samples, parameters, labels)
        for k, hole in enumerate(holes):
            if hole.field.shape[1] == 0:
                continue
            pull = prior * (parameters[k] - fits.prior_mean[k]) * (np.arange(SIZE) >= TILT_U)
            weights = _weights(left[k], hole.labels, scale)
            solved = _solve(design[:, hole.index].T, value[hole.index], hole.field, weights, prior, pull)
            parameters[k] += np.clip(solved.change, -0.1, 0.1)
            if not samples.chamfered:
                parameters[k, CHAMFER] = parameters[k, WALL]
            left[k] = solved.left
            if step == 0:
                free += _freedoms(solved)
            if step == ROUNDS - 1:
                covariances[k] = _sandwich(solved, hole, noise, prior)
        scale = _scales(holes, left, scale, free, fits.sigma_mm)
    return replace(fits, parameters=parameters, covariances=covariances)


def _freedoms(solved: _Solved) -> float:
    """Degrees of freedom that hole and field take: for the field, the variance that its unit prior loses."""
    size = len(solved.root)
    inverse = linalg.solve_triangular(solved.root, np.eye(size), lower=True, check_finite=False)
    return SIZE + size - float((inverse**2).sum())


def _sandwich(solved: _Solved, hole: _Hole, noise: SharedNoise, prior: Array) -> Array:
    """Covariance (9, 9) of the estimate under the noise as it is, not as lattice and weights approximate it.

    How smooth the noise is, is only known so well, and the gain rests on it: it is taken a little rougher than found.
    """
    rougher = SharedNoise(ROUGHER * noise.length_px, noise.share - min(noise.share, 1.0 - ROUGHER) * 0.1)
    influence = solved.influence * hole.amplitude[:, None]
    scatter = influence.T @ correlated(influence, hole.pixels, rougher) + np.diag(prior)
    covariance = np.asarray(solved.covariance @ scatter @ solved.covariance)
    covariance[[CU, CV], [CU, CV]] += (MODEL_FLOOR * float(np.abs(hole.amplitude).max())) ** 2
    return covariance


@dataclass(frozen=True, slots=True)
class _Solved:
    """Change (9,) of the parameters and inverse (9, 9) of their normal matrix, influence (m, 9) of the points,
    residuals left by hole and field, Cholesky root (p, p) of the field's normal matrix."""

    change: Array
    covariance: Array
    influence: Array
    left: Array
    root: Array


def _solve(design: Array, value: Array, field: Array, weights: Array, prior: Array, pull: Array) -> _Solved:
    """One Gauss-Newton step of hole and field together; the field is eliminated (Schur complement)."""
    weighted = field * weights[:, None]
    inner = weighted.T @ field
    inner[np.diag_indices_from(inner)] += 1.0
    factor = linalg.cho_factor(inner, lower=True, overwrite_a=True, check_finite=False)
    sides = linalg.cho_solve(factor, weighted.T @ np.column_stack([design, value]), check_finite=False)
    reduced = design - field @ sides[:, :SIZE]
    normal = (design * weights[:, None]).T @ reduced + np.diag(prior)
    covariance: Array = np.linalg.inv(0.5 * (normal + normal.T)).astype(np.float64)
    influence = reduced * weights[:, None]
    change = -covariance @ (influence.T @ value + pull)
    left = value - field @ sides[:, SIZE] + reduced @ change
    return _Solved(change, covariance, influence, left, factor[0])


def _near(
    samples: Samples, parameters: Array, labels: NDArray[np.int8], value: Array, sigma_mm: Array, ring_mm: float
) -> NDArray[np.bool_]:
    """Points (M,) that are no outliers and lie in the hole or in the ring of face about it."""
    p = parameters[samples.owner]
    rho = np.hypot(samples.points[:, 0] - p[:, CU], samples.points[:, 1] - p[:, CV])
    fits_in = (labels >= 0) & (np.abs(value) < TUKEY * sigma_mm[labels])
    return np.asarray(fits_in & ((labels != FACE) | (rho < p[:, CHAMFER] + ring_mm)))


def _hole(
    samples: Samples, k: int, near: NDArray[np.bool_], labels: NDArray[np.int8], pixels: Array, noise: SharedNoise,
    amplitude: Array,
) -> _Hole:  # fmt: skip
    index = np.arange(samples.starts[k], samples.starts[k + 1])
    index = index[near[index]]
    own = labels[index]
    if len(index) < 2 * SIZE:
        return _Hole(index, own, pixels[index], np.zeros(len(index)), np.zeros((len(index), 0)))
    field = field_basis(pixels[index], noise) * (np.sqrt(noise.share) * amplitude[index])[:, None]
    return _Hole(index, own, pixels[index], amplitude[index], field)


def _weights(left: Array, labels: NDArray[np.int8], scale: Array) -> Array:
    """Tukey weights over the white variance; all equal in the first round, when no residual is known yet."""
    sigma = scale[labels]
    if len(left) != len(labels):
        return np.asarray(1.0 / sigma**2)
    ratio = left / (TUKEY * sigma)
    return np.where(np.abs(ratio) < 1.0, (1.0 - ratio**2) ** 2, 0.0) / sigma**2


def _scales(holes: list[_Hole], left: list[Array], scale: Array, free: float, sigma_mm: Array) -> Array:
    """White scale per surface from what field and hole leave, corrected for what they took up.

    Not below a share of the whole noise: no noise is as smooth as the model of it.
    """
    used = [k for k, rest in enumerate(left) if len(rest)]
    if not used:
        return scale
    labels, rest = np.concatenate([holes[k].labels for k in used]), np.concatenate([left[k] for k in used])
    taken = np.sqrt(len(rest) / max(len(rest) - free, 0.2 * len(rest)))
    result = scale.copy()
    for kind in range(3):
        part = rest[labels == kind]
        if len(part) >= 30:
            result[kind] = max(robust_sigma(part) * taken, np.sqrt(LEAST_WHITE) * sigma_mm[kind])
    return result
