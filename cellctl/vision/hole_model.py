"""The surfaces in and around a hole: face, chamfer and wall, which of them a ray meets, and how far points lie off.

Coordinates of a hole: u, v along the face from the hole's nominal centre, w above the face plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array

# parameters of one hole, in this order; the local face is w = H + A u + B v
CU, CV, CHAMFER, WALL, TILT_U, TILT_V, H, A, B = range(9)
SIZE = 9
FACE, CONE, CYLINDER, NONE = 0, 1, 2, -1
STRIP = -1e-9


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

    def each(self, values: Array) -> Array:
        """Values (K,) or (q, K) of the holes for each of their points."""
        return np.repeat(values, np.diff(self.starts), axis=-1)

    def take(self, rows: NDArray[np.intp]) -> Samples:
        """Some of the points, by ascending index."""
        counts = np.bincount(self.owner[rows], minlength=len(self.starts) - 1)
        crossing = None if self.crossing is None else self.crossing[:, rows]
        return Samples(
            self.points[rows], np.append(0, np.cumsum(counts)), self.owner[rows], crossing, self.slope, self.depth_mm,
            self.chamfered,
        )  # fmt: skip

    def thinned(self, step: int) -> Samples:
        """Every `step`-th point of each hole."""
        place = np.arange(len(self.points)) - self.starts[self.owner]
        return self.take(np.flatnonzero(place % step == 0))


def label(samples: Samples, parameters: Array, sigma_mm: Array) -> NDArray[np.int8]:
    """Which surface each point lies on. With a pinhole: the one its ray meets, so noise cannot change the label."""
    bottom = -(parameters[:, CHAMFER] - parameters[:, WALL]) / samples.slope
    if samples.crossing is None:
        return _label_nearest(samples, samples.each(parameters.T), samples.each(bottom), sigma_mm)
    u, v, du, dv = samples.crossing
    p = parameters.T
    # the ray at the height where the wall begins, against the axis there
    at = [p[CU], p[CV], p[CU] + p[TILT_U] * bottom, p[CV] + p[TILT_V] * bottom, bottom]
    cu, cv, at_u, at_v, low, mouth, neck = samples.each(np.stack([*at, np.square(p[CHAMFER]), np.square(p[WALL])]))
    on_cone = np.square(u + low * du - at_u) + np.square(v + low * dv - at_v) >= neck
    result = np.where(on_cone, np.int8(CONE), np.int8(CYLINDER))
    result[np.square(u - cu) + np.square(v - cv) >= mouth] = FACE
    x, y, deep = samples.points.T
    # a ray leaves the hole where it meets the wall: what lies on the side it came in by is a stray
    inward = (x - cu) * du + (y - cv) * dv > 0.0
    result[(result == CYLINDER) & (inward | (deep < -samples.depth_mm) | (deep > 0.5 * low))] = NONE
    return result


def _label_nearest(samples: Samples, p: Array, bottom: Array, sigma_mm: Array) -> NDArray[np.int8]:
    """By place alone; what is nearer than noise to an edge is left out, because its label would be a guess."""
    rho, height = _polar(samples.points, p)
    guard = 2.5 * sigma_mm
    result = np.full(len(rho), NONE, dtype=np.int8)
    result[(rho > p[CHAMFER] + guard[FACE]) & (np.abs(height) < 1.0)] = FACE
    on_cone = (height < -guard[FACE]) & (height > bottom + guard[CONE]) & (rho > p[WALL] - 1.0)
    if samples.chamfered:
        result[on_cone & (rho < p[CHAMFER] + guard[CONE])] = CONE
    wall = (height < bottom - guard[CYLINDER]) & (height > -samples.depth_mm) & (np.abs(rho - p[WALL]) < 1.0)
    result[wall & (height < -2.0 * guard[FACE])] = CYLINDER
    return result


def _polar(points: Array, p: Array) -> tuple[Array, Array]:
    """Distance from the hole's axis and height above the local face, for each point with its parameters (9, M)."""
    u, v, w = points.T
    rho = np.hypot(u - p[CU] - p[TILT_U] * w, v - p[CV] - p[TILT_V] * w)
    return np.asarray(rho), np.asarray(w - p[H] - p[A] * u - p[B] * v)


def residuals(samples: Samples, parameters: Array, labels: NDArray[np.int8]) -> tuple[Array, Array]:
    """Orthogonal distances (M,) to the labelled surfaces and their derivatives (9, M); zero where unlabelled."""
    u, v, w = samples.points.T
    p = samples.each(parameters.T)
    qu, qv = u - p[CU] - p[TILT_U] * w, v - p[CV] - p[TILT_V] * w
    rho = np.maximum(np.sqrt(qu * qu + qv * qv), 1e-9)
    height = w - p[H] - p[A] * u - p[B] * v
    cosine = 1.0 / np.sqrt(1.0 + samples.slope**2)
    face, cone, wall = (labels == kind for kind in (FACE, CONE, CYLINDER))
    lateral, level = np.where(cone, cosine, 1.0 * wall), np.where(cone, samples.slope * cosine, -1.0 * face)
    limit = np.where(cone, p[CHAMFER], p[WALL])
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
    (x, y), centre = samples.points[:, :2].T, samples.each(parameters[:, [CU, CV]].T)
    qu, qv = x - centre[0], y - centre[1]
    out = (qu * du + qv * dv) * fall / np.maximum(np.sqrt(qu * qu + qv * qv), 1e-9)
    cone = (out - samples.slope * fall) / np.sqrt(1.0 + samples.slope**2)
    return np.asarray(np.abs(np.where(labels == FACE, fall, np.where(labels == CONE, cone, out))))
