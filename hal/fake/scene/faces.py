"""Rings, bevels and bore of a part: surfaces coaxial with its z, met by every ray in closed form.

The camera stands inside the cylinder of the innermost edge, so that walls seen from outside are never met first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.hits import FLAT, ROUND, HitBuffer, Indices
from hal.fake.scene.shapes import PartShape

Array = NDArray[np.float64]


def face_hits(hits: HitBuffer, T_camera_part: Array, shape: PartShape) -> None:
    """Add the part's rings, bevels and bore; then mark what the rings' edges hide from an eye."""
    R = T_camera_part[:3, :3]
    origin = -R.T @ T_camera_part[:3, 3]
    ray = [R[0, i] * hits.u + R[1, i] * hits.v + R[2, i] for i in range(3)]
    for inner, outer, z in shape.rings_mm:
        with np.errstate(divide="ignore"):
            depth = (z - origin[2]) / ray[2]
        radius2 = (origin[0] + depth * ray[0]) ** 2 + (origin[1] + depth * ray[1]) ** 2
        met = (radius2 >= inner * inner) & (radius2 <= outer * outer) & (depth > 0.0) & (depth < hits.depth)
        pixels = np.flatnonzero(met)
        hits.depth[pixels] = depth[pixels]
        hits.normal[pixels] = R[:, 2]
        hits.owner[pixels] = FLAT
        hits.dark[pixels] = _behind_edge(hits, pixels, T_camera_part, shape, (inner, outer, z))
    for bevel in shape.bevels_mm:
        _bevel(hits, R, origin, ray, bevel)
    if shape.bore_mm is not None:
        _bore(hits, R, origin, ray, shape.bore_mm)


def _bevel(
    hits: HitBuffer, R: Array, origin: Array, ray: list[Array], bevel: tuple[float, float, float, float]
) -> None:
    """Cone r = r0 + (z - z0) s, looked for only where the ray passes near it."""
    r0, z0, r1, z1 = bevel
    middle = (0.5 * (z0 + z1) - origin[2]) / ray[2]
    radius = np.hypot(origin[0] + middle * ray[0], origin[1] + middle * ray[1])
    pixels = np.flatnonzero((radius > min(r0, r1) - 2.0) & (radius < max(r0, r1) + 2.0))
    d = np.stack([component[pixels] for component in ray], axis=1)
    s = (r1 - r0) / (z1 - z0)
    w = r0 + (origin[2] - z0) * s
    a = d[:, 0] ** 2 + d[:, 1] ** 2 - (s * d[:, 2]) ** 2
    b = origin[0] * d[:, 0] + origin[1] * d[:, 1] - s * w * d[:, 2]
    c = origin[0] ** 2 + origin[1] ** 2 - w * w
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    for sign in (-1.0, 1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(b * sign > 0.0, c / (-b - sign * root), (-b + sign * root) / a)
        p = origin + depth[:, None] * d
        inside = (p[:, 2] >= min(z0, z1)) & (p[:, 2] <= max(z0, z1)) & (b * b >= a * c)
        inside &= r0 + (p[:, 2] - z0) * s > 0.0
        r = np.hypot(p[inside, 0], p[inside, 1])
        normal = np.stack([p[inside, 0] / r, p[inside, 1] / r, np.full(r.size, -s)], axis=1) / np.hypot(1.0, s)
        normal *= -np.sign(np.sum(normal * d[inside], axis=1, keepdims=True))
        hits.keep(pixels[inside], depth[inside], normal @ R.T, ROUND, False)


def _bore(hits: HitBuffer, R: Array, origin: Array, ray: list[Array], bore: tuple[float, float, float]) -> None:
    """Cylinder met from inside: the far root of the quadratic."""
    radius, upper, lower = bore
    pixels = np.flatnonzero(np.isinf(hits.depth))
    d = np.stack([component[pixels] for component in ray], axis=1)
    a = d[:, 0] ** 2 + d[:, 1] ** 2
    b = origin[0] * d[:, 0] + origin[1] * d[:, 1]
    c = origin[0] ** 2 + origin[1] ** 2 - radius * radius
    with np.errstate(divide="ignore"):
        depth = -c / (b + np.sqrt(np.maximum(b * b - a * c, 0.0)))
    z = origin[2] + depth * d[:, 2]
    inside = (z <= upper) & (z >= lower) & (c < 0.0)
    p = origin + depth[inside, None] * d[inside]
    normal = np.column_stack([-p[:, :2] / radius, np.zeros(len(p))])
    hits.keep(pixels[inside], depth[inside], normal @ R.T, ROUND, False)


def _behind_edge(
    hits: HitBuffer, pixels: Indices, T_camera_part: Array, shape: PartShape, ring: tuple[float, float, float]
) -> NDArray[np.bool_]:
    """Which points of `ring` an eye cannot see because the edge of a ring in front of it is in the way."""
    dark = np.zeros(pixels.size, dtype=np.bool_)
    front = [other for other in shape.rings_mm if other[2] > ring[2]]
    if not front:
        return dark
    R = T_camera_part[:3, :3]
    # Shadows reach as far as the step is high, for eyes within 45 degrees of the normal.
    reach = max(other[2] for other in front) - ring[2]
    p = (hits.points(pixels) - T_camera_part[:3, 3]) @ R
    r = np.hypot(p[:, 0], p[:, 1])
    close = np.zeros(pixels.size, dtype=np.bool_)
    for inner, outer, _ in front:
        close |= (np.abs(r - outer) < reach) | (np.abs(r - inner) < reach)
    rows = np.flatnonzero(close)
    for eye in hits.camera.eyes_mm:
        e = (np.asarray(eye) - T_camera_part[:3, 3]) @ R
        for inner, outer, z in front:
            share = (z - p[rows, 2]) / (e[2] - p[rows, 2])
            q = np.hypot(*(p[rows, i] + share * (e[i] - p[rows, i]) for i in range(2)))
            dark[rows] |= (q > inner) & (q < outer)
    return dark
