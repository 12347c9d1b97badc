"""Where studs end: heights above the face at which flat ends show, and the ends at one height. Pure.

An end is a disc at one height with nothing beside it, whatever the stud's length; its middle lies on the axis, while
the middle of all that is seen of a stud leans towards the camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array
from cellctl.vision.grid import Void, find_islands, rasterise
from cellctl.vision.part import Part

BIN_MM = 0.2
LEAST_HEIGHT_MM = 1.5
HALF_LEVEL_MM = 0.4
ROUND_SHARE = 0.2
"""Half the height of what counts as an end: the larger, for a round one is a share of its radius high."""
MOST_LEVELS = 4
LEAST_POINTS = 12
GROUND_POINTS = 40_000
LEAST_SHARE = 0.15
"""A level with a smaller share of the fullest one's points is not looked at."""


def radius_of(part: Part) -> float | None:
    """Nominal radius of the studs in mm, of their crests where they are threaded; None where the recipe gives none."""
    if part.thread is not None:
        return 0.5 * part.thread.major_diameter_mm
    return 0.5 * float(np.median(part.diameter_mm)) if part.diameter_mm is not None else None


def tip_levels(height_mm: NDArray[np.floating], part: Part) -> list[float]:
    """Heights above the face at which many of the points (N,) lie, fullest first; near the length where it is given."""
    low, high = LEAST_HEIGHT_MM, 2.0 * part.circle_diameter_mm
    if part.length_mm is not None:
        low, high = max(low, 0.8 * part.length_mm - 2.0), 1.2 * part.length_mm + 2.0
    cells = ((height_mm[(height_mm > low) & (height_mm < high)] - low) * (1.0 / BIN_MM)).astype(np.intp)
    counts = np.bincount(cells, minlength=3)
    smooth = np.convolve(counts, np.ones(3), mode="same")
    fullest = float(smooth.max())
    levels: list[float] = []
    while len(levels) < MOST_LEVELS:
        best = int(np.argmax(smooth))
        if smooth[best] < max(LEAST_SHARE * fullest, LEAST_POINTS):
            break
        near = np.arange(max(0, best - 1), min(len(counts), best + 2))
        levels.append(low + BIN_MM * float(np.average(near + 0.5, weights=counts[near])))
        smooth[max(0, best - 6) : best + 7] = 0.0
    return levels


def find_tips(uv_mm: Array, height_mm: Array, part: Part, spacing_mm: float, level_mm: float) -> list[Void]:
    """Discs of points (N, 2) at one height above the face, about as large as a stud's end where its size is known."""
    radius = radius_of(part)
    on = np.abs(height_mm - level_mm) < max(HALF_LEVEL_MM, ROUND_SHARE * (radius or 0.0))
    if np.count_nonzero(on) < LEAST_POINTS:
        return []
    cell = max(1.2 * spacing_mm, 0.2 * radius if radius is not None else 0.0)
    islands = find_islands(rasterise(uv_mm[on], cell, 4.0 * cell), least=3)
    if radius is not None:
        return [island for island in islands if 0.4 * radius < island.radius_mm < 1.5 * radius + cell]
    if not islands:
        return []
    usual = float(np.median([island.radius_mm for island in islands[: part.count]]))
    return [island for island in islands if 0.5 * usual < island.radius_mm < 2.0 * usual]


def standing(tips: list[Void], on_plane: Array, above: Array) -> list[Void]:
    """Those ends of studs about which the ground is the plane of these points (N, 2) rather than something above it.

    Above a plane far behind the part the same ends show, higher up; so do tops of clutter aside of the part.
    """
    radius = float(np.median([tip.radius_mm for tip in tips]))
    middles = np.array([tip.position_mm for tip in tips])
    low = middles.min(axis=0) - 4.0 * radius
    cell = 0.4 * radius
    shape = np.ceil((middles.max(axis=0) + 4.0 * radius - low) / cell).astype(np.intp) + 1
    owner = np.zeros(shape, dtype=np.intp)
    """Whose ground a cell is, counted from 1."""
    turns = 2.0 * np.pi * np.arange(32) / 32.0
    for reach in (1.6, 2.0, 2.4):
        ring = middles[:, None] + reach * radius * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        u, v = np.floor((ring - low) / cell).astype(np.intp).transpose(2, 0, 1)
        owner[u, v] = np.arange(1, len(tips) + 1)[:, None]
    step = max(1, (len(on_plane) + len(above)) // GROUND_POINTS)
    lower, higher = (_counted(owner, (points[::step] - low) / cell)[1:] for points in (on_plane, above))
    kept = lower >= higher
    return [tip for tip, keep in zip(tips, kept, strict=True) if keep] if lower[kept].sum() else []


def _counted(owner: NDArray[np.intp], places: Array) -> NDArray[np.intp]:
    """Points (N, 2), in cells, on the ground of each owner."""
    u, v = np.floor(places).astype(np.intp).T
    inside = (u >= 0) & (v >= 0) & (u < owner.shape[0]) & (v < owner.shape[1])
    return np.bincount(owner[u[inside], v[inside]], minlength=int(owner.max()) + 1)
