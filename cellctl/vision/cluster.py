"""The crest of a thread as clusters of points: robust seed and DBSCAN (eq. 10, 11, corrected). Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import ndtr

from cellctl.vision.geometry import Array

Labels = NDArray[np.intp]

MIN_POINTS = 4
"""MinPts of eq. 11."""


def dbscan(points: Array, eps: float, min_points: int = MIN_POINTS) -> Labels:
    """Cluster (n,) of each point (n, d), largest first from 0; -1 for noise.

    A core point has `min_points` points (itself included) within `eps`; border points go with their nearest core.
    Source: Ester, Kriegel, Sander, Xu, KDD 1996.
    """
    labels = np.full(len(points), -1, dtype=np.intp)
    if len(points) < min_points:
        return labels
    pairs = cKDTree(points).query_pairs(eps, output_type="ndarray")
    neighbours = np.bincount(pairs.ravel(), minlength=len(points)) + 1
    core = neighbours >= min_points
    joined = pairs[core[pairs].all(axis=1)]
    graph = coo_matrix((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(len(points), len(points)))
    _, found = connected_components(graph, directed=False)
    numbers, inverse, sizes = np.unique(found[core], return_inverse=True, return_counts=True)
    rank = np.empty(len(numbers), dtype=np.intp)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(numbers))
    labels[core] = rank[inverse]
    if core.any():
        border = np.flatnonzero(~core)
        distance, nearest = cKDTree(points[core]).query(points[border], distance_upper_bound=eps)
        reached = np.isfinite(distance)
        labels[border[reached]] = labels[core][np.asarray(nearest)[reached]]
    return labels


def spacing_of(points: Array) -> float:
    """Median distance to the second neighbour: eps is taken from it, because the paper gives none."""
    distance, _ = cKDTree(points).query(points, k=min(3, len(points)))
    return float(np.median(np.asarray(distance)[:, -1]))


def crest_seed(radii_mm: Array, noise_mm: float) -> float:
    """Radius of the crest: the outermost shell that many points share.

    Eq. 10 takes the farthest point, which one outlier becomes. Here the histogram of radii near its outer end is
    split into the crest's peak and the flanks' plateau below it, both scattered by the noise.
    """
    low, high = np.percentile(radii_mm, [60.0, 99.8])
    edges = np.arange(low, high + 6.0 * noise_mm, 0.3 * noise_mm)
    counts = np.histogram(radii_mm, edges)[0].astype(np.float64)
    middles = 0.5 * (edges[1:] + edges[:-1])
    start = float(middles[np.argmax(np.convolve(counts, np.ones(5) / 5.0, mode="same"))])
    near = np.abs(middles - start) < 5.0 * noise_mm
    x, y = middles[near] - start, counts[near]
    if len(x) < 6:
        return start

    def miss(p: Array) -> Array:
        z = (x - p[0]) / max(abs(p[1]), 0.1 * noise_mm)
        return np.asarray((p[2] * np.exp(-0.5 * z**2) + p[3] * ndtr(-z) - y) / np.sqrt(y + 3.0))

    fit = least_squares(miss, [0.0, 0.7 * noise_mm, y.max(), 0.3 * y.max()], method="lm")
    return start + float(np.clip(fit.x[0], -2.0 * noise_mm, 2.0 * noise_mm))


def crest_points(points: Array, *, noise_mm: float, depth_mm: float) -> tuple[NDArray[np.bool_], float]:
    """Which points (n,) of a stud lie on its crest band, and the crest's radius, mm.

    `points` (n, 3) in the stud's frame, its axis along z. The band reaches `depth_mm` below the crest; what DBSCAN
    (eq. 11, MinPts 4, eps from the spacing) does not join to a cluster is noise.
    """
    radii = np.hypot(points[:, 0], points[:, 1])
    crest = crest_seed(radii, noise_mm)
    band = np.flatnonzero((radii > crest - depth_mm) & (radii < crest + 5.0 * noise_mm))
    chosen = np.zeros(len(points), dtype=np.bool_)
    if len(band) >= MIN_POINTS:
        labels = dbscan(points[band], 2.5 * spacing_of(points[band]))
        chosen[band[labels >= 0]] = True
    return chosen, crest
