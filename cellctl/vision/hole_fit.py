"""The joint robust fit of wall, chamfer and face edge of all holes of a part (eq. 19-20, corrected).

The paper takes hulls of the outline; an outline is limited by the sampling, while chamfer and wall carry the
information. Holes are fitted side by side, because they share their noise, its growth with the slant of a surface, and
how much they lean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array
from cellctl.vision.hole_model import (
    CHAMFER,
    CONE,
    CYLINDER,
    FACE,
    SIZE,
    TILT_U,
    TILT_V,
    WALL,
    Samples,
    facing,
    label,
    residuals,
)
from cellctl.vision.plane import TUKEY, robust_sigma

TILT_PRIOR_RAD = np.radians(0.03)  # machined holes stand square to their face
TILT_DEGREES = 4.0  # what is known beforehand of how holes lean weighs as much as two holes
EM_ROUNDS = 40
SLOPE_PRIOR = 5e-4  # long-wave ripple of the scanner tilts the neighbourhood of one hole
LIFT_PRIOR_MM = 0.01
THINNED = 300  # points of a hole that bring its fit near
STILL_MM = 1e-4
BLOCK = 1024
LEAST_COSINE = 0.08  # nearer to grazing, what the model leaves out outweighs noise


@dataclass(frozen=True, slots=True)
class HoleFits:
    """Parameters (K, 9), their covariances (K, 9, 9) type A with priors, scales of the three surfaces, label counts.

    `residual_mm` (K,) is the robust residual of cone and wall, `counts` (K, 3) the points kept per surface,
    `prior_mean` (K, 9) where the priors pull and `prior` (9,) their precisions. Noise across a
    surface is `sigma_mm` times the cosine of incidence to `slant_power`.
    """

    parameters: Array
    covariances: Array
    sigma_mm: Array
    counts: NDArray[np.intp]
    residual_mm: Array
    inflation: float
    prior_mean: Array
    prior: Array
    slant_power: float


@dataclass(frozen=True, slots=True)
class _State:
    """One round of the fit: the last normal matrices (K, 9, 9) and gradients (K, 9) of the data, and what made them."""

    parameters: Array
    scale: Array
    normal: Array
    gradient: Array
    labels: NDArray[np.int8]
    value: Array
    weights: Array
    amplitude: Array


def fit(samples: Samples, start: Array, sigma_mm: float) -> HoleFits:
    """Gauss-Newton with Tukey weights on all holes; the scale of each surface comes from the pooled residuals.

    Thinned points come near; all points decide. How noise goes with the slant of a surface (`slant_power`) and how much
    holes lean (`tilt_prior`) is learnt from all holes.
    """
    scale = np.array([sigma_mm, 3.0 * sigma_mm, 3.0 * sigma_mm])
    prior = priors(samples.chamfered)
    step = len(samples.points) // (THINNED * max(len(start), 1))
    rough = samples.thinned(step) if step > 1 else samples
    state = _rounds(rough, start, start, scale, prior, wide=3.0, rounds=4)
    state = _rounds(rough, state.parameters, start, state.scale, prior, rounds=8)
    power = slant_power(state.labels, state.value, state.weights, facing(rough, state.parameters, state.labels))
    scale = state.scale / np.maximum(_middles(rough, state), LEAST_COSINE) ** power
    state = _rounds(samples, state.parameters, start, scale, prior, power=power, rounds=5)
    factor = inflation(samples, state.value / state.amplitude, state.weights, state.labels, state.scale)
    prior = tilt_prior(state, start, prior, factor)
    state = _rounds(samples, state.parameters, start, state.scale, prior, power=power, rounds=2)
    kept = state.weights > 0.0
    count = len(start)
    counts = np.bincount(samples.owner[kept] * 3 + state.labels[kept], minlength=3 * count).reshape(count, 3)
    inner = kept & (state.labels != FACE)
    ends = zip(samples.starts[:-1], samples.starts[1:], strict=True)
    residual = [robust_sigma(state.value[a:b][inner[a:b]]) if inner[a:b].any() else np.nan for a, b in ends]
    covariances = np.asarray(np.linalg.inv(state.normal + np.diag(prior)) * factor)
    return HoleFits(state.parameters, covariances, state.scale, counts, np.array(residual), factor, start, prior, power)


def slant_power(labels: NDArray[np.int8], value: Array, weights: Array, cosine: Array) -> float:
    """Power (0 to 1) of the cosine of incidence with which noise across a surface falls as its slant grows.

    1 where the noise along the ray is the same everywhere, 0 where it grows as fast as the slant. From the median
    residuals of thirds of every surface, by their cosine.
    """
    x, y, n = [], [], []
    for kind in range(3):
        rows = np.flatnonzero((labels == kind) & (weights > 0.0))
        if len(rows) < 90:
            continue
        for third in np.array_split(rows[np.argsort(cosine[rows], kind="stable")], 3):
            x.append(float(np.mean(np.log(np.maximum(cosine[third], LEAST_COSINE)))))
            y.append(float(np.log(np.median(np.abs(value[third])) + 1e-9)))
            n.append(len(third))
    if not n or np.ptp(x) < 0.1:
        return 0.0
    dx, dy = (np.array(values) - np.average(values, weights=n) for values in (x, y))
    return float(np.clip(np.average(dx * dy, weights=n) / np.average(dx * dx, weights=n), 0.0, 1.0))


def _middles(samples: Samples, state: _State) -> Array:
    """Median cosine of incidence (3,) on each surface; 1 where it shows no points."""
    cosine = facing(samples, state.parameters, state.labels)
    kinds = [cosine[state.labels == kind] for kind in range(3)]
    return np.array([float(np.median(values)) if len(values) else 1.0 for values in kinds])


def _rounds(
    samples: Samples, parameters: Array, mean: Array, scale: Array, prior: Array, *, wide: float = 1.0,
    power: float = 0.0, rounds: int,
) -> _State:  # fmt: skip
    """Rounds of Gauss-Newton until the centres rest."""
    parameters = parameters.copy()
    own = prior * (np.arange(SIZE) > WALL)
    labels = label(samples, parameters, scale)
    amplitude = np.maximum(facing(samples, parameters, labels), LEAST_COSINE) ** power
    for step in range(rounds):
        if step:
            labels = label(samples, parameters, scale)
        value, design = residuals(samples, parameters, labels)
        scale = _scales(value / amplitude, labels, scale)
        weights = _weights(value, labels, scale, amplitude, wide=wide)
        normal, gradient = _normal(samples.starts, design, weights, value)
        pull = gradient + own * (parameters - mean)
        change = -np.linalg.solve(normal + np.diag(prior), pull[:, :, None])[:, :, 0]
        change[:, :4] = np.clip(change[:, :4], -0.3, 0.3)
        parameters += change
        if not samples.chamfered:
            parameters[:, CHAMFER] = parameters[:, WALL]
        if float(np.abs(change[:, :2]).max(initial=0.0)) < STILL_MM:
            break
    return _State(parameters, scale, normal, gradient, labels, value, weights, amplitude)


def _normal(starts: NDArray[np.intp], design: Array, weights: Array, value: Array) -> tuple[Array, Array]:
    """Weighted normal matrices (K, 9, 9) and gradients (K, 9) of every hole.

    In blocks so small that the matrix library gives them to one thread: sums must not depend on its number.
    """
    rows = np.concatenate([design, value[None]])
    weighted = rows * weights
    count = len(starts) - 1
    result = np.zeros((count, SIZE + 1, SIZE + 1))
    for k in range(count):
        for begin in range(starts[k], starts[k + 1], BLOCK):
            block = np.s_[:, begin : min(begin + BLOCK, starts[k + 1])]
            result[k] += weighted[block] @ rows[block].T
    return result[:, :SIZE, :SIZE], result[:, :SIZE, SIZE]


def tilt_prior(state: _State, mean: Array, prior: Array, factor: float) -> Array:
    """The priors with the holes' lean as wide as all holes together show it (empirical Bayes by EM).

    A few degrees of freedom stand for what drawings allow, so that few holes do not claim to know it well. `factor`
    widens the data's variances for noise that pixels share.
    """
    tilts, others = [TILT_U, TILT_V], [k for k in range(SIZE) if k not in (TILT_U, TILT_V)]
    gradient = state.gradient - np.einsum("kij,kj->ki", state.normal, state.parameters - mean)
    whole = state.normal + np.diag(np.where(np.isin(np.arange(SIZE), tilts), 0.0, prior))
    across = whole[:, tilts][:, :, others]
    solved = np.linalg.solve(whole[:, others][:, :, others], np.concatenate(
        [across.transpose(0, 2, 1), gradient[:, others, None]], axis=2))  # fmt: skip
    information = (whole[:, tilts][:, :, tilts] - across @ solved[:, :, :2]) / factor
    side = -(gradient[:, tilts] - (across @ solved[:, :, 2:])[:, :, 0]) / factor
    variance = TILT_PRIOR_RAD**2
    for _ in range(EM_ROUNDS):
        spread = np.linalg.inv(information + np.eye(2) / variance)
        tilt = np.einsum("kij,kj->ki", spread, side)
        shown = float(np.square(tilt).sum() + np.trace(spread, axis1=1, axis2=2).sum())
        variance = (shown + TILT_DEGREES * TILT_PRIOR_RAD**2) / (2.0 * len(tilt) + TILT_DEGREES)
    result = prior.copy()
    result[tilts] = 1.0 / variance
    return result


def priors(chamfered: bool) -> Array:
    """Precisions (9,) of the priors: none on the place, next to none on the sizes, the face normal on the axis."""
    loose, fixed = 1e-2, 1e8
    square, level, lift = TILT_PRIOR_RAD**-2, SLOPE_PRIOR**-2, LIFT_PRIOR_MM**-2
    return np.array([loose, loose, loose if chamfered else fixed, loose, square, square, lift, level, level])


def _weights(value: Array, labels: NDArray[np.int8], scale: Array, amplitude: Array, *, wide: float) -> Array:
    """Tukey weight over variance for every point, 0 for what lies on no surface."""
    sigma = np.where(labels >= 0, scale[labels], 1.0) * amplitude
    ratio = value / (TUKEY * wide * sigma)
    return np.where((labels >= 0) & (np.abs(ratio) < 1.0), (1.0 - ratio**2) ** 2 / sigma**2, 0.0)


def _scales(value: Array, labels: NDArray[np.int8], scale: Array) -> Array:
    """Robust scale per surface, pooled over the holes; the old one where a surface shows next to no points."""
    result = scale.copy()
    for kind in (FACE, CONE, CYLINDER):
        part = value[(labels == kind) & (np.abs(value) < 3.0 * TUKEY * scale[kind])]
        if len(part) >= 30:
            result[kind] = max(robust_sigma(part), 1e-6)
    return result


def inflation(
    samples: Samples, value: Array, weights: Array, labels: NDArray[np.int8], scale: Array,
    index: NDArray[np.intp] | None = None,
) -> float:  # fmt: skip
    """Factor on variances for noise that neighbouring pixels share: sums over patches against their white value.

    All arrays are (m,); `index` (m,) names the samples they belong to, all of them where it is None.
    """
    chosen = np.arange(len(samples.points)) if index is None else index
    angle = np.arctan2(samples.points[chosen, 1], samples.points[chosen, 0])
    sector = np.floor((angle + np.pi) / (2.0 * np.pi) * 7.999).astype(np.intp)
    patch = (samples.owner[chosen] * 3 + np.maximum(labels, 0)) * 8 + sector
    used = weights > 0.0
    z = value[used] / scale[labels[used]]
    sums = np.bincount(patch[used], weights=z)
    return max(1.0, float((sums**2).sum() / max(float((z**2).sum()), 1e-12)))
