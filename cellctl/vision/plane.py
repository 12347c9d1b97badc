"""Planes in a cloud with clutter (eq. 14-18 of the paper): RANSAC finds them, a robust refit says where they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Column, Columns, inner, total
from cellctl.vision.flatness import flatness_mm
from cellctl.vision.geometry import Array, PlaneFrame, robust_sigma, unit
from cellctl.vision.part import FaceFit, Refused

TUKEY = 4.685  # 95 % efficient for white noise
LONGER = 1.2  # steps of reweighting are too short, for weights fall where residuals grow: E w / E psi' of such noise
BLOCK_MM = 6.0
JUDGES, FIRST_JUDGES, HEARD = 600, 120, 100
THINNED = 20_000  # points that tell a scale, or where to start, as well as all of them
LEVEL_ROUNDS = 12
STILL_MM, STILL_RAD = 2e-4, 4e-6  # the next step is a hundredth: a tenth of what noise leaves unknown of the best face
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
    normals, distances = normals.astype(np.float32), distances.astype(np.float32)
    judges = points[rng.integers(0, len(points), min(len(points), JUDGES))]
    q = np.ascontiguousarray(judges.T, dtype=np.float32)
    # a few judges tell which planes are worth a vote of all (preemptive: Nister, Mach. Vis. Appl. 16 (2005) 321)
    likely = np.argsort(-_votes(normals, distances, q[:, :FIRST_JUDGES], tau_mm), kind="stable")[:HEARD]
    votes = _votes(normals[likely], distances[likely], q, tau_mm)
    # the best few are told apart after a refit: a tilted plane through three noisy points catches few votes
    best: Plane | None = None
    for index in likely[np.argsort(-votes, kind="stable")[:3]]:
        plane = refit(judges, Plane(normals[index], float(distances[index]), tau_mm, 0), tau_mm, rounds=ROUGH_ROUNDS)
        if best is None or plane.points > best.points:
            best = plane
    return best


def _votes(normals: Column, distances: Column, points: Column, tau_mm: float) -> NDArray[np.intp]:
    """How many of points (3, M) lie within `tau_mm` of each plane (n, 3), (n,)."""
    apart = normals[:, :1] * points[0]
    apart += normals[:, 1:2] * points[1]
    apart += normals[:, 2:] * points[2]
    apart -= distances[:, None]
    return np.asarray(np.count_nonzero(np.abs(apart, out=apart) < tau_mm, axis=1))


def refit(points: Array, start: Plane, tau_mm: float, *, rounds: int = 50) -> Plane:
    """Tukey-weighted orthogonal refit to convergence with sigma from the data.

    A single refit inside tau pins the plane to its start; this widens to what the data says and goes on until still.
    """
    normal, distance, sigma, near = start.normal, start.distance_mm, tau_mm, 0
    columns = np.ascontiguousarray(points.T)
    residuals = np.einsum("j,jn->n", normal, columns) - distance
    for step in range(rounds):
        reach = 2.0 * tau_mm if step < 2 else TUKEY * sigma
        weights = np.square(np.maximum(1.0 - np.square(residuals / reach), 0.0))
        near = int(np.count_nonzero(weights))
        if near < 3:
            break
        centre = np.einsum("n,jn->j", weights, columns) / weights.sum()
        offset = columns - centre[:, None]
        new = np.linalg.eigh(np.einsum("in,jn->ij", weights * offset, offset))[1][:, 0]
        new = new if new @ normal > 0 else -new
        moved = float(np.linalg.norm(new - normal)) * 100.0 + abs(float(new @ centre) - distance)
        normal, distance = new, float(new @ centre)
        residuals = np.einsum("j,jn->n", normal, columns) - distance
        sigma = max(robust_sigma(residuals[np.abs(residuals) < max(reach, 3.0 * sigma)]), RESOLUTION_MM)
        if moved < SETTLED_MM and step > 1:
            break
    return Plane(normal, distance, sigma, near)


def fit_face(local: Columns, frame: PlaneFrame, sigma_mm: float, area: Columns | None = None) -> FaceFit:
    """The face as a result: plane refitted on points of the face alone, given in the coordinates of a `frame` near it.

    Its normal goes the way of the frame's. `sigma_mm` about tells the noise. Flatness is told by `area`, points of the
    face's area in the frame whether they lie near its plane or not, else by the points. The covariance is the
    white-noise one times the inflation seen in blocks of 6 mm (neighbouring pixels share noise). Raises Refused
    face_not_found with fewer than 50 points.
    """
    if len(local) < 50:
        raise Refused("face_not_found", f"{len(local)} points on the face, at least 50 are needed")
    thin = local.take(np.s_[:: max(1, len(local) // THINNED)])
    level, sigma, _ = _level(thin, thin, np.zeros(3), 2.0 * sigma_mm)
    level, sigma, spread = _level(local, thin, level, sigma)
    means, counts = _block_means(local, level, TUKEY * sigma)
    kept = int(counts.sum())
    if kept < 50:
        raise Refused("face_not_found", "the face's points do not lie in one plane")
    # height above the plane at (u, v) = offset - tilt1 * u + tilt0 * v, right-handed about the two tangents
    u, v = spread[0, 1:] / spread[0, 0]
    about = np.array([[1.0, 0.0, 0.0], [-v, 0.0, 1.0], [u, -1.0, 0.0]])
    spread = about @ spread @ about.T * (kept / spread[0, 0])
    covariance = sigma**2 * _inflation(means, counts, sigma) * np.linalg.inv(spread)
    point = frame.out(np.array([u, v, level @ [1.0, u, v]]))
    on = PlaneFrame.on(point, unit(frame.axes.T @ np.array([-level[1], -level[2], 1.0])), frame.axes[0])
    area = thin if area is None else area
    shared = float(np.sqrt(covariance[0, 0] * min(kept, len(area))))
    return FaceFit(
        point_mm=point,
        normal=on.axes[2],
        tilt_axes=on.axes[:2],
        covariance=covariance,
        sigma_mm=sigma,
        flatness_mm=flatness_mm(replace(area, z=area.z - _height(level, area)), sigma, shared),
        points=kept,
        inliers=kept / len(local),
    )


def _height(level: Array, points: Columns) -> Column:
    """Height (N,) of the plane w = level . (1, u, v) at each point."""
    a, b, c = level.astype(np.float32)
    height = points.x * b
    height += points.y * c
    height += a
    return np.asarray(height)


def _level(points: Columns, some: Columns, level: Array, sigma: float) -> tuple[Array, float, Array]:
    """Tukey-weighted plane (3,) w = a + b u + c v from `level`, to convergence, its scale as `some` of the points show
    it, and the weighted sums (3, 3) of products of (1, u, v)."""
    for _ in range(LEVEL_ROUNDS):
        left = some.z - _height(level, some)
        sigma = max(robust_sigma(left[np.abs(left) < TUKEY * sigma]), RESOLUTION_MM)
        sums, slack = np.zeros((3, 4)), 0.0
        for _, piece in points.batches():
            moments, loose = _moments(piece, level, TUKEY * sigma)
            sums, slack = sums + moments, slack + loose
        # weights fall where residuals grow, so that the steps of reweighting are all too short by the same share
        # (Newton: sum of psi' for sum of w); twice a step still leads down
        far = sums[0, 0] / max(5.0 * sums[0, 0] - 4.0 * slack, 0.5 * sums[0, 0])
        step = far * np.linalg.lstsq(sums[:, :3], sums[:, 3], rcond=None)[0]
        level = level + step
        if abs(step[0]) < STILL_MM and np.abs(step[1:]).max() < STILL_RAD:
            break
    return level, sigma, sums[:, :3]


def _moments(points: Columns, level: Array, reach_mm: float) -> tuple[Array, float]:
    """Weighted normal matrix and right-hand side (3, 4) of a step of the plane `level`, and the sum of the weights'
    roots."""
    left = points.z - _height(level, points)
    weights = left * np.float32(1.0 / reach_mm)
    np.square(weights, out=weights)
    np.subtract(np.float32(1.0), weights, out=weights)
    np.maximum(weights, np.float32(0.0), out=weights)
    roots = total(weights)
    np.square(weights, out=weights)
    wu, wv = weights * points.x, weights * points.y
    first, second, third = total(wu), total(wv), inner(wu, points.y)
    return np.array([
        [total(weights), first, second, inner(weights, left)],
        [first, inner(wu, points.x), third, inner(wu, left)],
        [second, third, inner(wv, points.y), inner(wv, left)],
    ]), roots  # fmt: skip


def _block_means(points: Columns, level: Array, reach_mm: float) -> tuple[Array, Array]:
    """Mean height (U, V) over the plane `level` in every block of a raster of 6 mm, NaN where it holds few points, and
    the number (U, V) of points within `reach_mm` of the plane."""
    scale = np.float32(1.0 / BLOCK_MM)
    low = points.x.min(), points.y.min()
    shape = [int((side.max() - least) * scale) + 1 for side, least in zip((points.x, points.y), low, strict=True)]
    counts, sums = np.zeros((2, shape[0] * shape[1]))
    for _, piece in points.batches():
        height = piece.z - _height(level, piece)
        on = np.flatnonzero(np.abs(height) < reach_mm)
        rows, columns = ((side.take(on) - least) * scale for side, least in zip((piece.x, piece.y), low, strict=True))
        index = rows.astype(np.intp) * shape[1] + columns.astype(np.intp)
        counts += np.bincount(index, minlength=len(counts))
        sums += np.bincount(index, weights=height.take(on), minlength=len(sums))
    enough = counts >= 0.3 * np.median(counts[counts > 0]) if counts.any() else counts > 0
    means = np.where(enough, sums / np.maximum(counts, 1.0), np.nan)
    return means.reshape(shape), counts.reshape(shape)


def _inflation(means: Array, counts: Array, sigma_mm: float) -> float:
    """How much more block means scatter than white noise would let them: the factor on a variance, at least 1.

    Differences of neighbouring blocks are used (Allan variance), so that long waves, which belong to type B, do
    not count.
    """
    scatter = []
    for first, second, n1, n2 in (
        (means[1:], means[:-1], counts[1:], counts[:-1]),
        (means[:, 1:], means[:, :-1], counts[:, 1:], counts[:, :-1]),
    ):
        both = np.isfinite(first) & np.isfinite(second)
        scatter.append((first - second)[both] ** 2 / (1.0 / n1[both] + 1.0 / n2[both]))
    values = np.concatenate(scatter)
    return max(1.0, float(values.mean()) / sigma_mm**2) if len(values) >= 5 else 1.0
