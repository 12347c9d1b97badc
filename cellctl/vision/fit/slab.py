"""The thinnest band between two parallel planes, or lines, that holds all points: the thinnest of all, by comparison.

One of its planes holds a facet of the convex hull, or both hold an edge (Houle & Toussaint, IEEE PAMI 10 (1988) 761).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from cellctl.vision.fit.result import Array

BLOCK = 200
"""Edges that are compared with all others at a time."""


def thinnest(points: Array) -> tuple[Array, float]:
    """Unit normal and width of the thinnest band about points (n, 2) or (n, 3), given along their principal directions
    with the thinnest first. Points that lie in a plane to their rounding have the first direction."""
    extent = np.ptp(points, axis=0)
    normal, width = np.eye(len(extent))[0], float(extent[0])
    if width <= 1e-15 * extent[-1]:
        return normal, width
    try:  # stretched points have the same facets, and Qhull's tolerances are made for such
        hull = ConvexHull(points / extent)
    except QhullError:
        return normal, width
    corners = points[hull.vertices]
    for normals in _supports(points, hull):
        length = np.linalg.norm(normals, axis=1)
        unit = normals[length > 0.0] / length[length > 0.0, None]
        widths = np.ptp(unit @ corners.T, axis=1)
        if len(widths) and widths.min() < width:
            normal, width = unit[np.argmin(widths)], float(widths.min())
    return normal, width


def _supports(points: Array, hull: ConvexHull) -> Iterator[Array]:
    """Normals (k, d), in blocks: those of the facets, then in space those across two edges."""
    sides = points[hull.simplices]
    along = sides[:, 1] - sides[:, 0]
    if points.shape[1] == 2:
        yield np.column_stack([-along[:, 1], along[:, 0]])
    else:
        yield np.cross(along, sides[:, 2] - sides[:, 0])
        yield from _between_edges(points, hull)


def _between_edges(points: Array, hull: ConvexHull) -> Iterator[Array]:
    """Normals across two edges of the hull that support it from opposite sides."""
    facet, corner = np.nonzero(hull.neighbors > np.arange(len(hull.simplices))[:, None])  # every edge once
    edges = hull.simplices[facet[:, None], (corner[:, None] + [1, 2]) % 3]
    beyond = hull.simplices[hull.neighbors[facet, corner]]
    beyond = beyond[(beyond[:, :, None] != edges[:, None, :]).all(axis=2)]
    start = points[edges[:, 0]]
    along = points[edges[:, 1]] - start
    wings = np.stack([points[hull.simplices[facet, corner]], points[beyond]], axis=1) - start[:, None]
    size = float(np.ptp(points, axis=0).max())
    for first in range(0, len(edges), BLOCK):
        block = slice(first, first + BLOCK)
        normals = np.cross(along[block, None], along[None])
        slack = 1e-9 * size * np.linalg.norm(normals, axis=2)[..., None]
        here = np.einsum("bei,bwi->bew", normals, wings[block])
        there = np.einsum("bei,ewi->bew", normals, wings)
        above = (here <= slack).all(axis=2) & (there >= -slack).all(axis=2)
        below = (here >= -slack).all(axis=2) & (there <= slack).all(axis=2)
        yield normals[above | below]
