"""Planes in a cloud with clutter (eq. 14-18 of the paper): RANSAC finds them, a robust refit says where they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Column, Columns, inner, total
from cellctl.vision.flatness import flatness_mm
from cellctl.vision.geometry import Array, PlaneFrame, robust_sigma, unit
from cellctl.vision.part import FaceFit, Refused

TUKEY = 4.685  # 95 % efficient for white noise
BLOCK_MM = 6.0
JUDGES = 600
THINNED = 20_000  # points that tell a scale, or where to start, as well as all of them
LEVEL_ROUNDS = 12
STILL_MM, STILL_RAD = 2e-6, 2e-8  # a tenth of what noise leaves unknown of the best face
ROUGH_ROUNDS = 6  # as many tell which candidate is better
SETTLED_MM = 1e-3  # of a plane that tells where to start
RESOLUTION_MM = 1e-4  # of float32 at some hundred millimetres


@dataclass(frozen=True, slots=True)
class Plane:
    """n . p = d with unit `normal` (3,); `sigma_mm` is the robust scale of residuals, `points` how many lie on it."""

    normal: Array
    distance_mm: float
    sigma_mm: float
    points: int

    def residuals(self, points: Array) -> Array:
        """Signed distances of points (..., 3) in mm, positive on the side of the normal."""
        return np.asarray(np.einsum("...j,j->...", points, self.normal) - self.distance_mm)


def find_planes(
    points: Array, rng: np.random.Generator, *, count: int = 8, tau_mm: float = 0.15, trials: int = 1000
) -> Iterator[Plane]:
    """Up to `count` planes in points (N, 3), the one with the most points first; each is looked for when it is asked.

    # eq. 14-16: three points make a plane, the plane with the most points within tau wins; k = 1000 trials
    # eq. 17, corrected: |d| < tau, the paper's signed distance takes a whole half space
    # eq. 18: l = 2 planes (face and ledge); more are looked for, because clutter has planes too
    """
    left = points
    planes: list[Plane] = []
    floor = max(50, len(points) // 200)
    for _ in range(count):
        if len(left) < 3 * floor:
            return
        found = _ransac(left, rng, tau_mm, trials)
        if found is None:
            return
        plane = refit(left, found, tau_mm)
        near = np.abs(plane.residuals(left)) < max(tau_mm, 4.0 * plane.sigma_mm)
        if np.count_nonzero(near) < floor:
            return
        if not any(_same(plane, other, left[near]) for other in planes):
            planes.append(plane)
            yield plane
        left = left[~near]


def _same(plane: Plane, other: Plane, points: Array) -> bool:
    """Whether `plane` is only the shell of strays about another one."""
    apart = abs(float(np.median(other.residuals(points))))
    return abs(float(plane.normal @ other.normal)) > 0.9998 and apart < 10.0 * other.sigma_mm


def _ransac(points: Array, rng: np.random.Generator, tau_mm: float, trials: int) -> Plane | None:
    """Best plane through three points out of `trials`, counted on a subset of the points."""
    chosen = points[rng.integers(0, len(points), (trials, 3))]
    normals = np.cross(chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    wide = lengths > 1e-3 * lengths.max(initial=0.0)
    if not wide.any() or lengths.max() == 0.0:
        return None
    normals = normals[wide] / lengths[wide, None]
    distances = np.einsum("ij,ij->i", normals, chosen[wide, 0])
    judges = points[rng.integers(0, len(points), min(len(points), JUDGES))]
    n, q = normals.astype(np.float32), judges.astype(np.float32)
    apart = n[:, :1] * q[:, 0] + n[:, 1:2] * q[:, 1] + n[:, 2:] * q[:, 2] - distances[:, None].astype(np.float32)
    votes = (np.abs(apart) < tau_mm).sum(axis=1)
    # the best few are told apart after a refit: a tilted plane through three noisy points catches few votes
    best: Plane | None = None
    for index in np.argsort(-votes, kind="stable")[:3]:
        plane = refit(judges, Plane(normals[index], float(distances[index]), tau_mm, 0), tau_mm, rounds=ROUGH_ROUNDS)
        if best is None or plane.points > best.points:
            best = plane
    return best


def refit(points: Array, start: Plane, tau_mm: float, *, rounds: int = 50) -> Plane:
    """Tukey-weighted orthogonal refit to convergence with sigma from the data.

    A single refit inside tau pins the plane to its start; this widens to what the data says and goes on until still.
    """
    normal, distance, sigma = start.normal, start.distance_mm, tau_mm
    near = 0
    for step in range(rounds):
        residuals = Plane(normal, distance, sigma, 0).residuals(points)
        reach = 2.0 * tau_mm if step < 2 else TUKEY * sigma
        inside = np.abs(residuals) < reach
        near = int(np.count_nonzero(inside))
        if near < 3:
            break
        weights = (1.0 - (residuals[inside] / reach) ** 2) ** 2
        selected = points[inside]
        centre = np.einsum("i,ij->j", weights, selected) / weights.sum()
        offset = selected - centre
        new = np.linalg.eigh(np.einsum("ij,i,ik->jk", offset, weights, offset))[1][:, 0]
        new = new if new @ normal > 0 else -new
        moved = float(np.linalg.norm(new - normal)) * 100.0 + abs(float(new @ centre) - distance)
        normal, distance = new, float(new @ centre)
        residuals = Plane(normal, distance, sigma, 0).residuals(points)
        sigma = max(robust_sigma(residuals[np.abs(residuals) < max(reach, 3.0 * sigma)]), RESOLUTION_MM)
        if moved < SETTLED_MM and step > 3:
            break
    return Plane(normal, distance, sigma, near)


def fit_face(points: Columns, start: Plane, toward: Array, area: Columns | None = None) -> FaceFit:
    """The face as a result: plane refitted on `points` of the face alone, normal on the side of `toward` (3,).

    Flatness is told by `area`, points of the face's area whether they lie near its plane or not, else by `points`.
    The covariance is the white-noise one times the inflation seen in blocks of 6 mm (neighbouring pixels share
    noise). Raises Refused face_not_found with fewer than 50 points.
    """
    if len(points) < 50:
        raise Refused("face_not_found", f"{len(points)} points on the face, at least 50 are needed")
    normal = start.normal if toward @ start.normal > start.distance_mm else -start.normal
    centre = np.array([total(points.x), total(points.y), total(points.z)]) / len(points)
    frame = PlaneFrame.on(centre - start.residuals(centre) * start.normal, normal)
    local = points.into(frame)
    thin = local.take(np.s_[:: max(1, len(points) // THINNED)])
    level, sigma = _level(local, *_level(thin, np.zeros(3), 2.0 * start.sigma_mm))
    height = local.z - _height(level, local)
    kept = np.flatnonzero(np.abs(height) < TUKEY * sigma)
    if len(kept) < 50:
        raise Refused("face_not_found", "the face's points do not lie in one plane")
    on, height = local.take(kept), height[kept]
    middle = np.array([total(on.x), total(on.y)]) / len(on)
    point = frame.out(np.append(middle, level @ np.append(1.0, middle)))
    frame = PlaneFrame.on(point, unit(frame.axes.T @ np.array([-level[1], -level[2], 1.0])))
    inflation = _inflation(height, _blocks(on, BLOCK_MM), sigma)
    # height above the plane at (u, v) = offset - tilt1 * u + tilt0 * v, right-handed about the two tangents
    u, v = on.x - np.float32(middle[0]), on.y - np.float32(middle[1])
    spread = np.array([[float(len(on)), 0.0, 0.0], [0.0, inner(v, v), -inner(u, v)], [0.0, -inner(u, v), inner(u, u)]])
    covariance = sigma**2 * inflation * np.linalg.inv(spread)
    area = points.take(np.s_[:: max(1, len(points) // THINNED)]) if area is None else area
    shared = float(np.sqrt(covariance[0, 0] * min(len(on), len(area))))
    return FaceFit(
        point_mm=point,
        normal=frame.axes[2],
        tilt_axes=frame.axes[:2],
        covariance=covariance,
        sigma_mm=sigma,
        flatness_mm=flatness_mm(area.into(frame), sigma, shared),
        points=len(on),
        inliers=len(on) / len(points),
    )


def _height(level: Array, points: Columns) -> Column:
    """Height (N,) of the plane w = level . (1, u, v) at each point."""
    a, b, c = level.astype(np.float32)
    height = points.x * b
    height += points.y * c
    height += a
    return np.asarray(height)


def _level(points: Columns, level: Array, sigma: float) -> tuple[Array, float]:
    """Tukey-weighted plane (3,) w = a + b u + c v from `level`, to convergence, and its scale."""
    some = points.take(np.s_[:: max(1, len(points) // THINNED)])
    for _ in range(LEVEL_ROUNDS):
        left = some.z - _height(level, some)
        sigma = max(robust_sigma(left[np.abs(left) < TUKEY * sigma]), RESOLUTION_MM)
        sums = sum((_moments(piece, level, TUKEY * sigma) for _, piece in points.batches()), np.zeros((3, 4)))
        step = np.linalg.lstsq(sums[:, :3], sums[:, 3], rcond=None)[0]
        level = level + step
        if abs(step[0]) < STILL_MM and np.abs(step[1:]).max() < STILL_RAD:
            break
    return level, sigma


def _moments(points: Columns, level: Array, reach_mm: float) -> Array:
    """Weighted normal matrix and right-hand side (3, 4) of a step of the plane `level`."""
    left = points.z - _height(level, points)
    weights = left * np.float32(1.0 / reach_mm)
    np.square(weights, out=weights)
    np.subtract(np.float32(1.0), weights, out=weights)
    np.maximum(weights, np.float32(0.0), out=weights)
    np.square(weights, out=weights)
    wu, wv = weights * points.x, weights * points.y
    first, second, third = total(wu), total(wv), inner(wu, points.y)
    return np.array([
        [total(weights), first, second, inner(weights, left)],
        [first, inner(wu, points.x), third, inner(wu, left)],
        [second, third, inner(wv, points.y), inner(wv, left)],
    ])  # fmt: skip


def _blocks(local: Columns, width_mm: float) -> tuple[NDArray[np.int32], tuple[int, int]]:
    """Number of the block (row-major) of each point, and the shape of the raster."""
    scale = np.float32(1.0 / width_mm)
    rows = ((local.x - local.x.min()) * scale).astype(np.int32)
    columns = ((local.y - local.y.min()) * scale).astype(np.int32)
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    rows *= np.int32(shape[1])
    rows += columns
    return rows, shape


def _block_means(height: Column, blocks: tuple[NDArray[np.int32], tuple[int, int]]) -> tuple[Array, Array]:
    index, shape = blocks
    counts = np.bincount(index, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    sums = np.bincount(index, weights=height, minlength=shape[0] * shape[1]).reshape(shape)
    enough = counts >= 0.3 * np.median(counts[counts > 0])
    return np.where(enough, sums / np.maximum(counts, 1.0), np.nan), counts


def _inflation(height: Column, blocks: tuple[NDArray[np.int32], tuple[int, int]], sigma_mm: float) -> float:
    """How much more block means scatter than white noise would let them: the factor on a variance, at least 1.

    Differences of neighbouring blocks are used (Allan variance), so that long waves, which belong to type B, do
    not count.
    """
    means, counts = _block_means(height, blocks)
    scatter = []
    for first, second, n1, n2 in (
        (means[1:], means[:-1], counts[1:], counts[:-1]),
        (means[:, 1:], means[:, :-1], counts[:, 1:], counts[:, :-1]),
    ):
        both = np.isfinite(first) & np.isfinite(second)
        scatter.append((first - second)[both] ** 2 / (1.0 / n1[both] + 1.0 / n2[both]))
    values = np.concatenate(scatter)
    return max(1.0, float(values.mean()) / sigma_mm**2) if len(values) >= 5 else 1.0
