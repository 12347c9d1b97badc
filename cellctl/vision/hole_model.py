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


@dataclass(frozen=True, slots=True)
class Samples:
    """Points (M, 3) in the coordinates of their holes, sorted by hole; hole k owns `starts[k]:starts[k + 1]`.

    `eyes` (K, 3): the pinhole in each hole's coordinates, None where no pinhole is known.
    """

    points: Array
    starts: NDArray[np.intp]
    eyes: Array | None
    slope: float
    depth_mm: float
    chamfered: bool

    @property
    def owner(self) -> NDArray[np.intp]:
        """Hole number of every point (M,)."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))


@dataclass(frozen=True, slots=True)
class HoleFits:
    """Parameters (K, 9), their covariances (K, 9, 9) type A with priors, scales of the three surfaces, label counts.

    `residual_mm` (K,) is the robust residual of cone and wall, `counts` (K, 3) the points kept per surface,
    `prior_mean` (K, 9) where the priors pull.
    """

    parameters: Array
    covariances: Array
    sigma_mm: Array
    counts: NDArray[np.intp]
    residual_mm: Array
    inflation: float
    prior_mean: Array


def label(samples: Samples, parameters: Array, sigma_mm: Array) -> NDArray[np.int8]:
    """Which surface each point lies on. With a pinhole: the one its ray meets, so noise cannot change the label."""
    p = parameters[samples.owner]
    bottom = -(p[:, CHAMFER] - p[:, WALL]) / samples.slope
    if samples.eyes is None:
        return _label_nearest(samples, p, bottom, sigma_mm)
    eye = samples.eyes[samples.owner]
    ray = samples.points - eye
    fall = np.where(ray[:, 2] < STRIP, ray[:, 2], STRIP)

    def radius_at(height: Array) -> Array:
        t = (height - eye[:, 2]) / fall
        u = eye[:, 0] + t * ray[:, 0] - p[:, CU] - p[:, TILT_U] * height
        v = eye[:, 1] + t * ray[:, 1] - p[:, CV] - p[:, TILT_V] * height
        return np.asarray(np.hypot(u, v))

    result = np.full(len(ray), CYLINDER, dtype=np.int8)
    result[radius_at(bottom) >= p[:, WALL]] = CONE
    result[radius_at(np.zeros(len(ray))) >= p[:, CHAMFER]] = FACE
    deep = samples.points[:, 2]
    result[(result == CYLINDER) & ((deep < -samples.depth_mm) | (deep > 0.5 * bottom))] = NONE
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
    """Orthogonal distances (M,) to the labelled surfaces and their derivatives (M, 9); zero where unlabelled."""
    p = parameters[samples.owner]
    u, v, w = samples.points.T
    qu, qv = u - p[:, CU] - p[:, TILT_U] * w, v - p[:, CV] - p[:, TILT_V] * w
    rho = np.maximum(np.hypot(qu, qv), 1e-9)
    height = w - p[:, H] - p[:, A] * u - p[:, B] * v
    cosine = 1.0 / np.sqrt(1.0 + samples.slope**2)
    face, cone, wall = (labels == kind for kind in (FACE, CONE, CYLINDER))
    value = np.zeros(len(u))
    value[face] = height[face]
    value[cone] = (rho - p[:, CHAMFER] - samples.slope * height)[cone] * cosine
    value[wall] = (rho - p[:, WALL])[wall]
    design = np.zeros((len(u), SIZE))
    lateral = np.where(cone, cosine, 0.0) + wall
    design[:, CU], design[:, CV] = -lateral * qu / rho, -lateral * qv / rho
    design[:, TILT_U], design[:, TILT_V] = design[:, CU] * w, design[:, CV] * w
    design[:, CHAMFER], design[:, WALL] = np.where(cone, -cosine, 0.0), np.where(wall, -1.0, 0.0)
    # the local face carries the chamfer with it
    level = np.where(face, -1.0, 0.0) + np.where(cone, samples.slope * cosine, 0.0)
    design[:, H], design[:, A], design[:, B] = level, level * u, level * v
    return value, design


def facing(samples: Samples, parameters: Array, labels: NDArray[np.int8]) -> Array:
    """Cosine (M,) of the angle between ray and surface normal at each point, 1 where no pinhole is known."""
    if samples.eyes is None:
        return np.ones(len(samples.points))
    p = parameters[samples.owner]
    ray = samples.points - samples.eyes[samples.owner]
    ray = ray / np.linalg.norm(ray, axis=1)[:, None]
    q = samples.points[:, :2] - p[:, [CU, CV]]
    out = (q * ray[:, :2]).sum(axis=1) / np.maximum(np.hypot(q[:, 0], q[:, 1]), 1e-9)
    cone = (out - samples.slope * ray[:, 2]) / np.sqrt(1.0 + samples.slope**2)
    return np.asarray(np.abs(np.where(labels == FACE, ray[:, 2], np.where(labels == CONE, cone, out))))


def fit(samples: Samples, start: Array, sigma_mm: float, *, rounds: int = 12) -> HoleFits:
    """Gauss-Newton with Tukey weights on all holes; the scale of each surface comes from the pooled residuals."""
    parameters = start.copy()
    scale = np.array([sigma_mm, 3.0 * sigma_mm, 3.0 * sigma_mm])
    prior = priors(samples.chamfered)
    count = len(start)
    normal = np.zeros((count, SIZE, SIZE))
    labels = label(samples, parameters, scale)
    weights, value, design = np.zeros(0), np.zeros(0), np.zeros((0, SIZE))
    for step in range(rounds):
        labels = label(samples, parameters, scale)
        value, design = residuals(samples, parameters, labels)
        weights = _weights(value, labels, scale, wide=3.0 if step < 3 else 1.0)
        moved = 0.0
        for k in range(count):
            part = slice(samples.starts[k], samples.starts[k + 1])
            weighted = design[part] * weights[part, None]
            normal[k] = weighted.T @ design[part] + np.diag(prior)
            pull = weighted.T @ value[part] + prior * (parameters[k] - start[k]) * (np.arange(SIZE) > WALL)
            change = np.linalg.solve(normal[k], -pull)
            change[:4] = np.clip(change[:4], -0.3, 0.3)
            parameters[k] += change
            if not samples.chamfered:
                parameters[k, CHAMFER] = parameters[k, WALL]
            moved = max(moved, float(np.abs(change[:2]).max()))
        scale = _scales(value, labels, scale)
        if step > 3 and moved < 1e-5:
            break
    factor = inflation(samples, value, weights, labels, scale)
    kept = weights > 0.0
    owner, count = samples.owner, len(start)
    counts = np.stack([np.bincount(owner[kept & (labels == kind)], minlength=count) for kind in range(3)], axis=1)
    inner = kept & (labels != FACE)
    ends = zip(samples.starts[:-1], samples.starts[1:], strict=True)
    residual = [robust_sigma(value[a:b][inner[a:b]]) if inner[a:b].any() else np.nan for a, b in ends]
    covariances = np.asarray(np.linalg.inv(normal) * factor)
    return HoleFits(parameters, covariances, scale, counts, np.array(residual), factor, start)


def priors(chamfered: bool) -> Array:
    """Precisions (9,) of the priors: none on the place, next to none on the sizes, the face normal on the axis."""
    loose, fixed = 1e-2, 1e8
    square, level, lift = TILT_PRIOR_RAD**-2, SLOPE_PRIOR**-2, LIFT_PRIOR_MM**-2
    return np.array([loose, loose, loose if chamfered else fixed, loose, square, square, lift, level, level])


def _weights(value: Array, labels: NDArray[np.int8], scale: Array, *, wide: float) -> Array:
    """Tukey weight over variance for every point, 0 for what lies on no surface."""
    sigma = np.where(labels >= 0, scale[labels], 1.0)
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
