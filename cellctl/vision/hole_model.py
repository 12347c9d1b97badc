"""The surfaces in and around a hole, and the joint robust fit of wall, chamfer and face edge (eq. 19-20, corrected).

The paper takes hulls of the outline; an outline is limited by the sampling, while chamfer and wall carry the
information. All holes of a part are fitted side by side, because they share their noise.

Coordinates of a hole: u, v along the face from the hole's nominal centre, w above the face plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array
from cellctl.vision.plane import TUKEY, robust_sigma

# parameters of one hole, in this order; the local face is w = H + A u + B v
CU, CV, CHAMFER, WALL, TILT_U, TILT_V, H, A, B = range(9)
SIZE = 9
FACE, CONE, CYLINDER, NONE = 0, 1, 2, -1
TILT_PRIOR_RAD = np.radians(0.03)  # machined holes stand square to their face
SLOPE_PRIOR = 5e-4  # long-wave ripple of the scanner tilts the neighbourhood of one hole
LIFT_PRIOR_MM = 0.01
STRIP = -1e-9
THINNED = 300  # points of a hole that bring its fit near
STILL_MM = 2e-5
BLOCK = 1024
LEAST_COSINE = 0.08  # nearer to grazing, what the model leaves out outweighs noise
EM_ROUNDS = 40
TILT_DEGREES = 4.0  # what is known beforehand of how holes lean weighs as much as two holes


@dataclass(frozen=True, slots=True)
class Samples:
    """Points (M, 3) in the coordinates of their holes, sorted by hole; hole k owns `starts[k]:starts[k + 1]`.

    `crossing` (4, M): where each point's ray meets w = 0 (u, v) and its change of u, v per unit of w; None where no
    pinhole is known.
    """

    points: Array
    starts: NDArray[np.intp]
    owner: NDArray[np.intp]
    crossing: Array | None
    slope: float
    depth_mm: float
    chamfered: bool

    @classmethod
    def of(
        cls, points: Array, starts: NDArray[np.intp], eyes: Array | None, *, slope: float, depth_mm: float,
        chamfered: bool,
    ) -> Samples:  # fmt: skip
        """With the pinhole `eyes` (K, 3) in each hole's coordinates, or None."""
        owner = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        if eyes is None:
            return cls(points, starts, owner, None, slope, depth_mm, chamfered)
        fall = np.minimum(points[:, 2] - eyes[owner, 2], STRIP)
        du, dv = ((points[:, axis] - eyes[owner, axis]) / fall for axis in (0, 1))
        u, v = (points[:, axis] - points[:, 2] * change for axis, change in ((0, du), (1, dv)))
        return cls(points, starts, owner, np.stack([u, v, du, dv]), slope, depth_mm, chamfered)

    def thinned(self, step: int) -> Samples:
        """Every `step`-th point of each hole."""
        place = np.arange(len(self.points)) - self.starts[self.owner]
        rows = np.flatnonzero(place % step == 0)
        counts = np.bincount(self.owner[rows], minlength=len(self.starts) - 1)
        crossing = None if self.crossing is None else self.crossing[:, rows]
        return Samples(
            self.points[rows], np.append(0, np.cumsum(counts)), self.owner[rows], crossing, self.slope, self.depth_mm,
            self.chamfered,
        )  # fmt: skip


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


def label(samples: Samples, parameters: Array, sigma_mm: Array) -> NDArray[np.int8]:
    """Which surface each point lies on. With a pinhole: the one its ray meets, so noise cannot change the label."""
    bottom = -(parameters[:, CHAMFER] - parameters[:, WALL]) / samples.slope
    owner = samples.owner
    if samples.crossing is None:
        return _label_nearest(samples, parameters[owner], bottom[owner], sigma_mm)
    u, v, du, dv = samples.crossing
    cu, cv = parameters[owner, CU], parameters[owner, CV]
    mouth = np.square(u - cu) + np.square(v - cv)
    # the ray at the height where the wall begins, against the axis there
    at_u, at_v = cu + (parameters[:, TILT_U] * bottom)[owner], cv + (parameters[:, TILT_V] * bottom)[owner]
    low = bottom[owner]
    neck = np.square(u + low * du - at_u) + np.square(v + low * dv - at_v)
    result = np.where(neck >= np.square(parameters[:, WALL])[owner], np.int8(CONE), np.int8(CYLINDER))
    result[mouth >= np.square(parameters[:, CHAMFER])[owner]] = FACE
    deep = samples.points[:, 2]
    result[(result == CYLINDER) & ((deep < -samples.depth_mm) | (deep > 0.5 * low))] = NONE
    return result


def _label_nearest(samples: Samples, p: Array, bottom: Array, sigma_mm: Array) -> NDArray[np.int8]:
    """By place alone; what is nearer than noise to an edge is left out, because its label would be a guess."""
    rho, height = _polar(samples.points, p)
    guard = 2.5 * sigma_mm
    result = np.full(len(rho), NONE, dtype=np.int8)
    result[(rho > p[:, CHAMFER] + guard[FACE]) & (np.abs(height) < 1.0)] = FACE
    on_cone = (height < -guard[FACE]) & (height > bottom + guard[CONE]) & (rho > p[:, WALL] - 1.0)
    if samples.chamfered:
        result[on_cone & (rho < p[:, CHAMFER] + guard[CONE])] = CONE
    wall = (height < bottom - guard[CYLINDER]) & (height > -samples.depth_mm) & (np.abs(rho - p[:, WALL]) < 1.0)
    result[wall & (height < -2.0 * guard[FACE])] = CYLINDER
    return result


def _polar(points: Array, p: Array) -> tuple[Array, Array]:
    """Distance from the hole's axis and height above the local face, for each point with its parameters (M, 9)."""
    u, v, w = points.T
    rho = np.hypot(u - p[:, CU] - p[:, TILT_U] * w, v - p[:, CV] - p[:, TILT_V] * w)
    return np.asarray(rho), np.asarray(w - p[:, H] - p[:, A] * u - p[:, B] * v)


def residuals(samples: Samples, parameters: Array, labels: NDArray[np.int8]) -> tuple[Array, Array]:
    """Orthogonal distances (M,) to the labelled surfaces and their derivatives (9, M); zero where unlabelled."""
    owner = samples.owner
    u, v, w = samples.points.T
    tilt_u, tilt_v = parameters[owner, TILT_U], parameters[owner, TILT_V]
    qu, qv = u - parameters[owner, CU] - tilt_u * w, v - parameters[owner, CV] - tilt_v * w
    rho = np.maximum(np.sqrt(qu * qu + qv * qv), 1e-9)
    height = w - parameters[owner, H] - parameters[owner, A] * u - parameters[owner, B] * v
    cosine = 1.0 / np.sqrt(1.0 + samples.slope**2)
    face, cone, wall = (labels == kind for kind in (FACE, CONE, CYLINDER))
    lateral, level = np.where(cone, cosine, 1.0 * wall), np.where(cone, samples.slope * cosine, -1.0 * face)
    limit = np.where(cone, parameters[owner, CHAMFER], parameters[owner, WALL])
    value = lateral * (rho - limit) - level * height
    design = np.empty((SIZE, len(u)))
    lateral /= rho
    np.multiply(lateral, -qu, out=design[CU])
    np.multiply(lateral, -qv, out=design[CV])
    np.multiply(design[CU], w, out=design[TILT_U])
    np.multiply(design[CV], w, out=design[TILT_V])
    np.multiply(cone, -cosine, out=design[CHAMFER])
    np.multiply(wall, -1.0, out=design[WALL])
    design[H] = level  # the local face carries the chamfer with it
    np.multiply(level, u, out=design[A])
    np.multiply(level, v, out=design[B])
    return value, design


def facing(samples: Samples, parameters: Array, labels: NDArray[np.int8]) -> Array:
    """Cosine (M,) of the angle between ray and surface normal at each point, 1 where no pinhole is known."""
    if samples.crossing is None:
        return np.ones(len(samples.points))
    _, _, du, dv = samples.crossing
    fall = 1.0 / np.sqrt(1.0 + du * du + dv * dv)
    q = samples.points[:, :2] - parameters[samples.owner][:, [CU, CV]]
    out = (q[:, 0] * du + q[:, 1] * dv) * fall / np.maximum(np.hypot(q[:, 0], q[:, 1]), 1e-9)
    cone = (out - samples.slope * fall) / np.sqrt(1.0 + samples.slope**2)
    return np.asarray(np.abs(np.where(labels == FACE, fall, np.where(labels == CONE, cone, out))))


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
    return HoleFits(
        state.parameters, covariances, state.scale, counts, np.array(residual), factor, start, prior, power
    )


def slant_power(labels: NDArray[np.int8], value: Array, weights: Array, cosine: Array) -> float:
    """Power (0 to 1) of the cosine of incidence with which noise across a surface falls as it is seen at more of a slant.

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
