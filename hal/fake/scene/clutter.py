"""Spheres of the artefact, posts, clamps and pipes: convex solids met where their interval of the ray begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.hits import ROUND, HitBuffer, bar_corners, dot, projected_box
from hal.fake.scene.shapes import Clutter

Array = NDArray[np.float64]
CLOSEST_MM = 200.0
"""Bars reach behind the camera; only what lies further than this is looked for."""


def clutter_hits(hits: HitBuffer, clutter: Clutter) -> None:
    """Add everything of `clutter` (scanner frame)."""
    _spheres(hits, clutter)
    bars, radius = visible_bars(clutter)
    if not len(bars):
        return
    pixels, k = hits.camera.windows(*projected_box(bar_corners(bars, radius)))
    ray = hits.rays(pixels)
    enter, leave = bar_interval(np.zeros_like(ray), ray, bars[k], radius[k])
    met = enter <= leave
    pixels, k, ray, depth = pixels[met], k[met], ray[met], enter[met]
    axis = bars[:, 1] - bars[:, 0]
    length = np.linalg.norm(axis, axis=1)
    axis = (axis / length[:, None])[k]
    from_start = depth[:, None] * ray - bars[k, 0]
    along = dot(from_start, axis)
    radial = (from_start - along[:, None] * axis) / radius[k, None]
    on_side = np.linalg.norm(radial, axis=1) > 1.0 - 1e-9
    cap = np.where(along > 0.5 * length[k], 1.0, -1.0)[:, None] * axis
    hits.keep(pixels, depth, np.where(on_side[:, None], radial, cap), ROUND, False)


def visible_bars(clutter: Clutter) -> tuple[Array, Array]:
    """Bars cut to what lies in front of the camera: ends (m, 2, 3) and radii (m,)."""
    ends = clutter.bars_mm
    low, high = ends[:, :, 2].min(axis=1, initial=np.inf), ends[:, :, 2].max(axis=1, initial=-np.inf)
    seen = high > CLOSEST_MM + 1.0
    ends, low = ends[seen].copy(), low[seen]
    for bar in np.flatnonzero(low < CLOSEST_MM):
        near, far = np.argsort(ends[bar, :, 2])
        share = (CLOSEST_MM - ends[bar, near, 2]) / (ends[bar, far, 2] - ends[bar, near, 2])
        ends[bar, near] += share * (ends[bar, far] - ends[bar, near])
    return ends, clutter.bar_radius_mm[seen]


def bar_interval(origin: Array, ray: Array, ends: Array, radius: Array) -> tuple[Array, Array]:
    """Parameters at which rays enter and leave round bars with flat ends, each (n,); enter > leave: missed."""
    axis = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(axis, axis=1)
    axis = axis / length[:, None]
    offset = origin - ends[:, 0]
    ray_along, off_along = dot(ray, axis), dot(offset, axis)
    ray_across, off_across = ray - ray_along[:, None] * axis, offset - off_along[:, None] * axis
    a = dot(ray_across, ray_across)
    b = dot(ray_across, off_across)
    c = dot(off_across, off_across) - radius**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        slab = np.sort(np.stack([-off_along / ray_along, (length - off_along) / ray_along]), axis=0)
        enter = np.where(b * b >= a * c, np.maximum((-b - root) / a, slab[0]), np.inf)
        leave = np.where(b * b >= a * c, np.minimum((-b + root) / a, slab[1]), -np.inf)
    return enter, leave


def sphere_interval(origin: Array, ray: Array, center: Array, radius: float) -> tuple[Array, Array]:
    """Parameters at which rays enter and leave spheres, each (n,); enter > leave: missed."""
    offset = origin - center
    a = dot(ray, ray)
    b = dot(ray, offset)
    c = dot(offset, offset) - radius * radius
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    met = b * b >= a * c
    return np.where(met, (-b - root) / a, np.inf), np.where(met, (-b + root) / a, -np.inf)


def _spheres(hits: HitBuffer, clutter: Clutter) -> None:
    radius = clutter.sphere_radius_mm
    centers = clutter.spheres_mm[clutter.spheres_mm[:, 2] > CLOSEST_MM]
    if not len(centers):
        return
    corners = bar_corners(np.stack([centers, centers], axis=1), np.full(len(centers), radius))
    pixels, k = hits.camera.windows(*projected_box(corners))
    ray = hits.rays(pixels)
    enter, leave = sphere_interval(np.zeros_like(ray), ray, centers[k], radius)
    met = enter <= leave
    normal = (enter[met, None] * ray[met] - centers[k[met]]) / radius
    hits.keep(pixels[met], enter[met], normal, ROUND, False)
