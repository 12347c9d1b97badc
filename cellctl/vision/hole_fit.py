"""The joint robust fit of wall, chamfer and face edge of all holes of a part (eq. 19-20, corrected).

The paper takes hulls of the outline; an outline is limited by the sampling, while chamfer and wall carry the
information. Holes are fitted side by side, because they share their noise, its growth with the slant of a surface, and
how much they lean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array, robust_sigma
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
from cellctl.vision.plane import LONGER, TUKEY

TILT_PRIOR_RAD = np.radians(0.02)  # machined holes stand square to their face
SIZE_PRIOR_MM = 0.03  # holes drawn alike differ by what tools and tolerances allow
LEAST_ALIKE = 4
PRIOR_DEGREES = 2.0  # what is known beforehand weighs as much as two measured values
EM_ROUNDS = 40
SLOPE_PRIOR = 1e-3  # long-wave ripple of the scanner tilts the neighbourhood of one hole
LIFT_PRIOR_MM = 0.01
THINNED, LEAST_THINNED = 150, 8000  # points of a hole, and of all of them at least, that bring the fit near
STILL_MM, NEARLY_STILL_MM = 2e-3, 5e-3  # what a lengthened step leaves is a twentieth of it
SCALED = 12_000  # points that tell a scale
BLOCK = 1024
LEAST_COSINE = 0.1  # nearer to grazing, what the model leaves out outweighs noise


@dataclass(frozen=True, slots=True)
class HoleFits:
    """Parameters (K, 9), their covariances (K, 9, 9) type A with priors, scales of the three surfaces, label counts.

    `residual_mm` (K,) is the robust residual of cone and wall, `counts` (K, 3) the points kept per surface,
    `prior_mean` (K, 9) where the priors pull and `prior` (K, 9) their precisions. Noise across a
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

    Thinned points come near; all points decide. How noise goes with the slant of a surface (`slant_power`), how much
    holes lean and how alike they are (`_pooled`) is learnt from all holes.
    """
    scale = np.array([sigma_mm, 3.0 * sigma_mm, 3.0 * sigma_mm])
    prior = np.tile(priors(samples.chamfered), (len(start), 1))
    step = len(samples.points) // max(THINNED * len(start), LEAST_THINNED)
    rough = samples.thinned(step) if step > 1 else samples
    state = _rounds(rough, start, start, scale, prior, wide=3.0, rounds=3)
    state = _rounds(rough, state.parameters, start, state.scale, prior, rounds=8, still_mm=NEARLY_STILL_MM)
    power = slant_power(state.labels, state.value, state.weights, facing(rough, state.parameters, state.labels))
    scale = state.scale / np.maximum(_middles(rough, state), LEAST_COSINE) ** power
    state = _rounds(samples, state.parameters, start, scale, prior, power=power, rounds=2)
    factor = inflation(samples, state.value / state.amplitude, state.weights, state.labels, state.scale)
    mean, prior = _pooled(state, start, priors(samples.chamfered), factor)
    # weights that take shared noise for white are too large by the factor, and so the priors' share has to be
    state = _rounds(samples, state.parameters, mean, state.scale, prior * factor, power=power, rounds=3)
    kept = state.weights > 0.0
    count = len(start)
    counts = np.bincount(samples.owner[kept] * 3 + state.labels[kept], minlength=3 * count).reshape(count, 3)
    inner = kept & (state.labels != FACE)
    ends = zip(samples.starts[:-1], samples.starts[1:], strict=True)
    residual = [robust_sigma(state.value[a:b][inner[a:b]]) if inner[a:b].any() else np.nan for a, b in ends]
    covariances = np.asarray(np.linalg.inv(state.normal / factor + _diagonal(prior)))
    return HoleFits(state.parameters, covariances, state.scale, counts, np.array(residual), factor, mean, prior, power)


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


def _diagonal(rows: Array) -> Array:
    """Diagonal matrices (K, n, n) of rows (K, n)."""
    return np.asarray(rows[:, :, None] * np.eye(rows.shape[1]))


def _middles(samples: Samples, state: _State) -> Array:
    """Median cosine of incidence (3,) on each surface; 1 where it shows no points."""
    cosine = facing(samples, state.parameters, state.labels)
    kinds = [cosine[state.labels == kind] for kind in range(3)]
    return np.array([float(np.median(values)) if len(values) else 1.0 for values in kinds])


def _rounds(
    samples: Samples, parameters: Array, mean: Array, scale: Array, prior: Array, *, wide: float = 1.0,
    power: float = 0.0, rounds: int, still_mm: float = STILL_MM,
) -> _State:  # fmt: skip
    """Rounds of Gauss-Newton until the centres rest."""
    parameters = parameters.copy()
    labels = label(samples, parameters, scale)
    amplitude = np.maximum(facing(samples, parameters, labels), LEAST_COSINE) ** power
    for step in range(rounds):
        if step:
            labels = label(samples, parameters, scale)
        value, design = residuals(samples, parameters, labels)
        scale = _scales(value / amplitude, labels, scale)
        weights = _weights(value, labels, scale, amplitude, wide=wide)
        normal, gradient = normal_equations(samples.starts, design, weights, value)
        pull = gradient + prior * (parameters - mean)
        longer = LONGER if wide == 1.0 else 1.0
        change = -longer * np.linalg.solve(normal + _diagonal(prior), pull[:, :, None])[:, :, 0]
        change[:, :4] = np.clip(change[:, :4], -0.3, 0.3)
        parameters += change
        if not samples.chamfered:
            parameters[:, CHAMFER] = parameters[:, WALL]
        if float(np.abs(change[:, :2]).max(initial=0.0)) < still_mm:
            break
    return _State(parameters, scale, normal, gradient, labels, value, weights, amplitude)


def normal_equations(starts: NDArray[np.intp], design: Array, weights: Array, value: Array) -> tuple[Array, Array]:
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


def _pooled(state: _State, mean: Array, prior: Array, factor: float) -> tuple[Array, Array]:
    """Prior means (K, 9) and precisions (K, 9) as all holes together show them (empirical Bayes by EM).

    How much holes lean, and how much the sizes of those drawn alike scatter about their mean. `factor` widens the
    data's variances for noise that pixels share.
    """
    weak = prior.copy()
    weak[[CHAMFER, WALL]] = np.minimum(weak[[CHAMFER, WALL]], 1.0)
    weak[[TILT_U, TILT_V]] = 1e-3 * TILT_PRIOR_RAD**-2
    inverse = np.linalg.inv(state.normal / factor + np.diag(weak))
    gradient = state.gradient / factor + weak * (state.parameters - mean)
    estimate = state.parameters - np.einsum("kij,kj->ki", inverse, gradient)
    variance = np.einsum("kii->ki", inverse)
    means, precisions = mean.copy(), np.tile(prior, (len(mean), 1))
    tilts = [TILT_U, TILT_V]
    precisions[:, tilts] = 1.0 / _spread(estimate[:, tilts].ravel(), variance[:, tilts].ravel(), TILT_PRIOR_RAD, 0.0)[1]
    for size in (CHAMFER, WALL):
        for drawn in np.unique(mean[:, size]):
            alike = np.flatnonzero(mean[:, size] == drawn)
            if len(alike) >= LEAST_ALIKE and prior[size] < 1.0:
                middle, scatter = _spread(estimate[alike, size], variance[alike, size], SIZE_PRIOR_MM)
                means[alike, size], precisions[alike, size] = middle, 1.0 / scatter
    return means, precisions


def _spread(values: Array, variances: Array, expected: float, middle: float | None = None) -> tuple[float, float]:
    """Mean (unless `middle` is it) and variance of true values, of which `values` (n,) are measured with `variances`.

    A few degrees of freedom stand for what drawings allow (`expected`, one sigma), so that few do not claim to know it
    well.
    """
    scatter, centre = expected**2, 0.0 if middle is None else middle
    for _ in range(EM_ROUNDS):
        weights = 1.0 / (variances + scatter)
        if middle is None:
            centre = float(weights @ values / weights.sum())
        shrunk = scatter * weights * (values - centre)
        shown = float((shrunk**2 + scatter * variances * weights).sum())
        scatter = (shown + PRIOR_DEGREES * expected**2) / (len(values) + PRIOR_DEGREES)
    return centre, scatter


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
    result, some = scale.copy(), np.s_[:: max(1, len(value) // SCALED)]
    value, labels = value[some], labels[some]
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
    x, y = samples.points[chosen, :2].T
    sector = (x > 0.0) + 2 * (y > 0.0) + 4 * (np.abs(x) > np.abs(y))  # an eighth of the way around
    patch = (samples.owner[chosen] * 3 + np.maximum(labels, 0)) * 8 + sector
    used = weights > 0.0
    z = value[used] / scale[labels[used]]
    sums = np.bincount(patch[used], weights=z)
    return max(1.0, float((sums**2).sum() / max(float((z**2).sum()), 1e-12)))
