"""Binocular vision: a point counts only if both eyes see it. Marks hits dark that stand in an eye's shadow.

Holes, ring edges and each stud's own thread mark themselves where they are met; here solids hide what lies behind
them. Shadows are looked for only in the pixels that parallax lets them reach.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.clutter import CLOSEST_MM, bar_interval, sphere_interval, visible_bars
from hal.fake.scene.hits import HitBuffer, Indices, bar_corners, dot, projected_box
from hal.fake.scene.shapes import Clutter

Array = NDArray[np.float64]
CLEAR_MM = 0.05
"""A solid that the line of sight leaves within this of the point does not hide it."""


def cast_shadows(hits: HitBuffer, clutter: Clutter) -> None:
    """Mark what studs and clutter (scanner frame) hide from an eye."""
    for ends, crest_radius, first_owner in hits.occluders:
        radius = np.full(len(ends), crest_radius)
        _shadows(hits, bar_corners(ends, radius), _bars(ends, radius), first_owner)
    bars, radius = visible_bars(clutter)
    _shadows(hits, bar_corners(bars, radius), _bars(bars, radius), None)
    centers = clutter.spheres_mm[clutter.spheres_mm[:, 2] > CLOSEST_MM]
    sphere_radius = clutter.sphere_radius_mm
    corners = bar_corners(np.stack([centers, centers], axis=1), np.full(len(centers), sphere_radius))
    _shadows(hits, corners, lambda k, p, d: sphere_interval(p, d, centers[k], sphere_radius), None)


Interval = Callable[[Indices, Array, Array], tuple[Array, Array]]


def _bars(ends: Array, radius: Array) -> Interval:
    return lambda k, p, d: bar_interval(p, d, ends[k], radius[k])


def _shadows(hits: HitBuffer, corners: Array, interval: Interval, first_owner: int | None) -> None:
    """Test the points behind each solid against it; `first_owner` names studs, which do not hide themselves here."""
    if not len(corners):
        return
    low, high = projected_box(corners)
    nearest = np.maximum(corners[..., 2].min(axis=1), hits.camera.near_mm)
    for eye in hits.camera.eyes_mm:
        # What lies at depth z behind a solid at depth n is shifted by eye (1/z - 1/n) in slopes.
        shift = np.asarray(eye)[:2] * (1.0 / hits.camera.far_mm - 1.0 / nearest)[:, None]
        pixels, k = hits.camera.windows(np.minimum(low, low + shift), np.maximum(high, high + shift))
        seen = np.isfinite(hits.depth[pixels]) & ~hits.dark[pixels]
        if first_owner is not None:
            seen &= hits.owner[pixels] != first_owner + k
        pixels, k = pixels[seen], k[seen]
        points = hits.points(pixels)
        direction = np.asarray(eye) - points
        direction /= np.sqrt(dot(direction, direction))[:, None]
        enter, leave = interval(k, points, direction)
        hits.dark[pixels[(enter <= leave) & (leave > CLEAR_MM)]] = True
