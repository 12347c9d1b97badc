"""How far a face is out of flat, told by all of it: also by the part that no plane through the rest would keep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array
from cellctl.vision.part import Part
from cellctl.vision.zones import rims

BLOCK_MM, EDGE_MM = 10.0, 1.5
REACH_MM = 3.0
"""What stands farther off the plane is another surface."""
STEP_MM = 0.3
"""From one block to the next, or inside one: more is no bend."""
LEAST_IN_BLOCK, ON_SHARE = 6, 0.4
EIGHT = np.ones((3, 3), dtype=np.bool_)
SPOTS = 1.0
"""Percent of the blocks on either side that may be dirt, a clamp or the scanner's fault."""


def inside_edges(local: Columns, part: Part, radii_mm: Array) -> NDArray[np.bool_]:
    """Which points (N,), in the part's frame, lie clear of the rims, which are broken or rounded on most parts."""
    inner, outer = rims(part, radii_mm)
    edge = min(EDGE_MM, 0.2 * (outer - inner))
    rho = np.hypot(local.x, local.y)
    return np.asarray((rho > inner + edge) & (rho < outer - edge))


def flatness_mm(local: Columns, sigma_mm: float, shared_mm: float) -> float:
    """Peak-to-valley of the face in mm, less what noise alone would give it; 0 where too little of it is seen.

    `local` are points of the face's area in a frame on its plane. Medians of blocks are compared, which wrong depths
    do not move. `sigma_mm` is the scatter about the plane, `shared_mm` the noise of a mean of as many neighbours as
    one of these points stands for.
    """
    near = np.flatnonzero(np.abs(local.z) < REACH_MM)
    if len(near) < 3 * LEAST_IN_BLOCK:
        return 0.0
    medians, counts, scatter = _blocks(local.take(near), sigma_mm)
    if not np.isfinite(medians).any():
        return 0.0
    face = _one_surface(medians, counts)
    if np.count_nonzero(face) < 3:
        return 0.0
    low, high = np.percentile(medians[face], [SPOTS, 100.0 - SPOTS])
    # a median scatters by pi / 2 more than a mean; points that lie close together share their noise
    noise = max(np.sqrt(0.5 * np.pi) * scatter, shared_mm) / np.sqrt(float(np.median(counts[face])))
    expected = 2.0 * noise * np.sqrt(2.0 * np.log(np.count_nonzero(face)))  # range of n normal values
    return float(np.sqrt(max((high - low) ** 2 - expected**2, 0.0)))


def _blocks(local: Columns, sigma_mm: float) -> tuple[Array, NDArray[np.intp], float]:
    """Median height (U, V) of every block of a raster, NaN where it is no piece of a face, its number of points, and
    the scatter inside blocks.

    Where a good share of a block lies on the plane, the rest belongs to edges and to what lies behind. A block whose
    middle half is deeper than any bend holds an edge.
    """
    rows = ((local.x - local.x.min()) / np.float32(BLOCK_MM)).astype(np.int64)
    columns = ((local.y - local.y.min()) / np.float32(BLOCK_MM)).astype(np.int64)
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    index = rows * shape[1] + columns
    size = shape[0] * shape[1]
    on = np.abs(local.z) < 5.0 * sigma_mm
    share = np.bincount(index, on, size) / np.maximum(np.bincount(index, minlength=size), 1)
    kept = np.flatnonzero(on | (share[index] < ON_SHARE))
    index = index[kept]
    # one sort of a number of which the block is the larger part
    order = np.sort(index * (4.0 * REACH_MM) + local.z[kept])
    counts = np.bincount(index, minlength=size)
    enough = np.flatnonzero(counts >= max(LEAST_IN_BLOCK, 0.3 * float(np.median(counts[counts > 0]))))
    first, n = (np.cumsum(counts) - counts)[enough], counts[enough]
    spread = order[first + (3 * n) // 4] - order[first + n // 4]
    smooth = spread < STEP_MM + 2.0 * sigma_mm
    medians = np.full(size, np.nan)
    medians[enough[smooth]] = (order[first + n // 2] - enough * (4.0 * REACH_MM))[smooth]
    return (
        medians.reshape(shape),
        counts.reshape(shape),
        float(np.median(spread[smooth] if smooth.any() else 0.0)) / 1.349,
    )


def _one_surface(medians: Array, counts: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which blocks (U, V) are the face: the largest surface without a step, and what no step parts from it.

    A pocket or a ledge in the face's area is another surface; a bent face goes on without a step.
    """
    labels = _without_step(medians)
    sizes = np.bincount(labels.ravel(), counts.ravel())
    sizes[0] = 0
    main = labels == sizes.argmax()
    beside = binary_dilation(main, EIGHT)
    stepped = np.unique(labels[beside & ~main])
    return np.asarray((labels > 0) & ~np.isin(labels, stepped[stepped > 0]) | main)


def _without_step(medians: Array) -> NDArray[np.intp]:
    """Number (U, V), from 1, of the surface that goes on from block to block without a step; 0 where there is none."""
    blocks = np.arange(medians.size).reshape(medians.shape)
    joined = []
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1]),
                       (np.s_[1:, 1:], np.s_[:-1, :-1]), (np.s_[1:, :-1], np.s_[:-1, 1:])):  # fmt: skip
        near = np.abs(medians[one] - medians[other]) < STEP_MM  # False beside NaN
        joined.append(np.stack([blocks[one][near], blocks[other][near]]))
    rows, columns = np.concatenate(joined, axis=1)
    graph = coo_array((np.ones(len(rows), dtype=np.bool_), (rows, columns)), shape=(medians.size, medians.size))
    labels = connected_components(graph, directed=False)[1].reshape(medians.shape)
    return np.where(np.isfinite(medians), labels + 1, 0)
