"""The points on each stud's side, with its height and middle, and radii that the recipe may not give. Pure.

Coordinates are those of the face: x, y along it, z above it. Everything is sorted by stud, pixels in order within.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array, median
from cellctl.vision.part import Part
from cellctl.vision.stud_tips import HALF_LEVEL_MM, radius_of
from cellctl.vision.thread_surface import Indices, Rays
from cellctl.vision.zones import nearest

LEAST_HEIGHT_MM = 0.6
"""Points nearer to the face may be the face's own."""
RIM_SHARE, BESIDE = 0.35, 0.2
"""The flat end is left out but for this share of the radius at its rim, where the lead-in may be."""
CREST_QUANTILE = 0.9
LEAST_IN_CORE = 12
ALL_AROUND, SURE_OF_EYE = 0.45, 0.5
"""Of points on half a cylinder the mean direction has a length of 0.64, of those all around none."""
OWN_SIDE = 1.0
"""Fall of a ray that looks at a point from its own side."""
USUAL_DISTANCE_MM = 350.0


@dataclass(frozen=True, slots=True)
class Near:
    """Rays sorted by stud, the pixel (N,) each came from (None for an unorganised cloud), first row of each stud
    (n + 1,), tips (n,) above the face, middles (n, 2) of the ends, where the axes were expected (n, 2), the common
    radius and what each has over it (n,)."""

    rays: Rays
    pixels: Indices | None
    starts: Indices
    tips: Array
    middles: Array
    expected: Array
    radius_mm: float
    extra_mm: Array

    @property
    def counts(self) -> NDArray[np.intp]:
        """Points (n,) on the side of each stud."""
        return np.diff(self.starts)

    def only(self, index: int) -> Near:
        """The sizes of one stud, without its points."""
        empty = self.rays.take(slice(0, 0))
        one = slice(index, index + 1)
        return Near(
            empty, None, np.zeros(2, np.intp), self.tips[one], self.middles[one], self.expected[one],
            self.radius_mm, self.extra_mm[one],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Around:
    """Rows (M,) of the points about the studs, sorted by stud; offsets (2, M) and distances (M,) from its expected
    axis, heights (M,)."""

    rows: Indices
    stud: Indices
    starts: Indices
    offset: Array
    distance: Array
    height: Array

    def of(self, index: int) -> tuple[Array, Array, Array]:
        """Offsets, distances and heights of one stud's points."""
        mine = slice(self.starts[index], self.starts[index + 1])
        return self.offset[:, mine], self.distance[mine], self.height[mine]


def gather(local: Array, pixels: Indices | None, centres: Array, part: Part, eye: Array) -> Near:
    """Points (3, N) above the face on the sides of the studs at about `centres` (n, 2); `eye` (3,) sees them."""
    radius = radius_of(part)
    gap = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    room = 0.5 * float(gap[gap > 1e-6].min())
    reach = min((1.0 + BESIDE) * radius + 1.0, room) if radius is not None else 0.9 * room
    around = _around(local, centres, reach)
    tips, middles = _ends(around, centres, part, 0.5 * (radius or 0.1 * reach), reach)
    if radius is None:
        radius = _radius(around, tips, middles - centres)
        tips, middles = _ends(around, centres, part, 0.5 * radius, 1.5 * radius)
    extra = np.zeros(len(centres))
    if part.diameter_mm is not None and part.thread is None:
        extra = 0.5 * np.asarray(part.diameter_mm) - radius
    size = radius + extra
    u, v = around.offset - (middles - centres).T[:, around.stud]
    square = u * u + v * v
    low, high = np.square((1.0 - RIM_SHARE) * size), np.square((1.0 + BESIDE) * size + 0.2)
    side = (around.height < (tips + 0.3)[around.stud]) & (square > low[around.stud]) & (square < high[around.stud])
    side = np.flatnonzero(side)
    rows, stud = around.rows[side], around.stud[side]
    points = local.take(rows, axis=1)
    if pixels is None:
        rays = _likely_rays(points, np.stack([u[side], v[side]]), stud, tips, middles, eye)
    else:
        rays = _unit(points - eye[:, None])
    starts = np.searchsorted(stud, np.arange(len(centres) + 1))
    chosen = pixels[rows] if pixels is not None else None
    return Near(Rays(points, rays, stud), chosen, starts, tips, middles, centres, radius, extra)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.sqrt(np.einsum("in,in->n", vectors, vectors)))


def _likely_rays(points: Array, offset: Array, stud: Indices, tips: Array, middles: Array, eye: Array) -> Array:
    """Unit rays (3, N) from the eye, from where the studs show that it stood, or each point from its own side.

    A list of points may not tell where its scanner was; studs do, because only their near sides are seen. A wrong
    place matters little: it turns the rays about points that lie on the surface.
    """
    low = np.flatnonzero(points[2] < 0.8 * tips[stud])
    outward = _unit(offset)
    count = np.maximum(np.bincount(stud[low], minlength=len(tips)), 1)
    sides = np.stack([np.bincount(stud[low], outward[axis, low], len(tips)) / count for axis in (0, 1)], axis=1)
    shown = np.hypot(*sides.T)
    if np.median(shown) < ALL_AROUND:
        return _unit(np.concatenate([-outward, np.full((1, len(stud)), -OWN_SIDE)]))
    towards = eye[:2] - middles
    agreed = np.sum(sides * towards) / max(float(np.sum(shown * np.hypot(*towards.T))), 1e-9)
    return _unit(points - (eye if agreed > SURE_OF_EYE else _eye(sides, middles))[:, None])


def _eye(sides: Array, middles: Array) -> Array:
    """Where (3,) a scanner stood that sees these sides (n, 2) of studs: their lines meet below it."""
    across = np.stack([-sides[:, 1], sides[:, 0]], axis=1)
    foot = np.linalg.lstsq(across, np.sum(across * middles, axis=1), rcond=None)[0]
    return np.append(foot, USUAL_DISTANCE_MM)


def _around(local: Array, centres: Array, reach: float) -> _Around:
    """Points within `reach` of an axis. A raster says which stud is near, so that no point is compared with all."""
    cell = 0.25 * reach
    low = centres.min(axis=0) - 2.0 * reach
    shape = np.ceil((centres.max(axis=0) + 2.0 * reach - low) / cell).astype(np.intp) + 1
    owner, _ = nearest(centres, low, cell, (int(shape[0]), int(shape[1])), reach + 1.5 * cell)
    u, v = (local[:2] - low[:, None]) / cell
    inside = np.flatnonzero((u >= 0) & (u < shape[0]) & (v >= 0) & (v < shape[1]))
    stud = owner[u[inside].astype(np.intp), v[inside].astype(np.intp)]
    rows = inside[stud >= 0]
    stud = stud[stud >= 0]
    order = np.argsort(stud, kind="stable")
    rows, stud = rows[order], stud[order].astype(np.intp)
    offset = local[:2].take(rows, axis=1) - centres.T[:, stud]
    distance = np.sqrt(offset[0] * offset[0] + offset[1] * offset[1])
    starts = np.searchsorted(stud, np.arange(len(centres) + 1))
    return _Around(rows, stud, starts, offset, distance, local[2].take(rows))


def _ends(around: _Around, centres: Array, part: Part, core_mm: float, most_mm: float) -> tuple[Array, Array]:
    """Height (n,) of each stud's flat end and its middle (n, 2); those of the others where none shows.

    The height is that of the points within `core_mm` of the expected axis, the middle that of all within `most_mm`.
    """
    tips, middles = np.full(len(centres), np.nan), centres.copy()
    for index in range(len(centres)):
        offset, distance, height = around.of(index)
        core = height[distance < core_mm]
        if len(core) < LEAST_IN_CORE < len(height):
            core = height[np.argpartition(distance, LEAST_IN_CORE)[:LEAST_IN_CORE]]
        if part.length_mm is not None:
            core = core[core > 0.6 * part.length_mm]
        if len(core) < 3:
            continue
        level = float(median(core))
        on = (np.abs(height - level) < HALF_LEVEL_MM) & (distance < most_mm)
        if np.count_nonzero(on) >= 3:
            tips[index] = level
            middles[index] += _middle(offset[:, on])
    shown = np.isfinite(tips)
    usual = float(np.median(tips[shown])) if shown.any() else (part.length_mm or 0.0)
    return np.where(shown, tips, usual), middles


def _middle(offset: Array) -> Array:
    """Mean (2,) of points (2, n) that fill a disc, strays apart."""
    distance = np.hypot(*(offset - median(offset)[:, None]))
    return np.asarray(offset[:, distance <= 2.0 * median(distance)].mean(axis=1))


def _radius(around: _Around, tips: Array, shift: Array) -> float:
    """Radius in mm that the sides of the studs reach: a high quantile, cleared of what lies around them."""
    side = (around.height > 2.0) & (around.height < tips[around.stud] - 1.0)
    distance = np.hypot(*(around.offset - shift.T[:, around.stud]))[side]
    if len(distance) < 20:
        return float(0.25 * np.hypot(*around.offset).max(initial=1.0))
    for _ in range(3):
        middle = float(np.median(distance))
        distance = distance[distance < 1.25 * middle]
    return float(np.quantile(distance, CREST_QUANTILE))
