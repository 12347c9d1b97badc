"""The rims of all chamfered holes at once: whether each is there, about where, and how much of it was seen.

A rim is limited by the sampling; it only says what the model of chamfer and wall may start from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array, row_medians

TUKEY = 6.0
"""An edge scatters with long tails that still carry its place: cut later than where noise is normal."""
STEPPED = 4.0
"""Neighbouring sectors stand off alike, and not evenly about the rim: errors do not average out as white noise."""


@dataclass(frozen=True, slots=True)
class Rims:
    """Circles through the innermost face points of each sector: `centre_mm` (K, 2) from the nominal places and its
    `covariance_mm2` (K, 2, 2), `radius_mm` (K,), `scatter_mm` (K,) of the edge, and how the rim looks.

    `arc` (K,) is the share of the sectors that show an edge near the circle, `fill` (K,) the share of the disk inside
    that face points cover; all NaN where next to no edge was seen.
    """

    centre_mm: Array
    covariance_mm2: Array
    radius_mm: Array
    scatter_mm: Array
    arc: Array
    fill: Array


def look(uv: Array, owner: NDArray[np.intp], radii_mm: Array, spacing_mm: float) -> Rims:
    """From face points (M, 2) about their nominal centres, hole number (M,) of each, and the rims' radii (K,)."""
    count = len(radii_mm)
    sectors = int(np.clip(2.0 * np.pi * float(np.median(radii_mm)) / (1.1 * spacing_mm), 12, 180))
    centre, radius = np.zeros((count, 2)), radii_mm.astype(np.float64)
    scatter, kept = np.full(count, np.nan), np.zeros((count, sectors), dtype=np.bool_)
    normal = np.tile(np.eye(3), (count, 1, 1))
    for _ in range(2):
        edge, direction = _edges(uv, owner, centre, radius, sectors)
        shift, radius, scatter, kept, normal = _circles(edge, direction, radius, spacing_mm)
        centre = centre + shift
    rho2 = np.square(uv[:, 0] - centre[owner, 0]) + np.square(uv[:, 1] - centre[owner, 1])
    inside = np.bincount(owner[rho2 < np.square(0.8 * radius)[owner]], minlength=count)
    seen = kept.sum(axis=1) >= max(8, sectors // 4)
    whole = np.where(seen, 1.0, np.nan)
    expected = np.maximum(np.pi * np.square(0.8 * radius) / spacing_mm**2, 1.0)
    return Rims(
        centre_mm=centre * whole[:, None],
        covariance_mm2=STEPPED * (np.square(scatter) * whole)[:, None, None] * np.linalg.inv(normal)[:, :2, :2],
        radius_mm=(radius - 0.5 * spacing_mm) * whole,  # the innermost point stands off by half a spacing on average
        scatter_mm=scatter,
        arc=np.mean(kept, axis=1) * whole,
        fill=inside / expected,
    )


def _edges(uv: Array, owner: NDArray[np.intp], centre: Array, radius: Array, sectors: int) -> tuple[Array, Array]:
    """Distance (K, S) of the innermost face point of every sector, infinite where there is none, and the direction
    (2, K, S) to it."""
    u, v = (uv[:, axis] - centre[owner, axis] for axis in (0, 1))
    rho = np.sqrt(u * u + v * v)
    near = (rho > 0.6 * radius[owner]) & (rho < 1.45 * radius[owner])
    sector = ((np.arctan2(v[near], u[near]) / (2.0 * np.pi) + 0.5) * sectors).astype(np.intp) % sectors
    place = owner[near] * sectors + sector
    edge = np.full(len(radius) * sectors, np.inf)
    np.minimum.at(edge, place, rho[near])
    innermost = rho[near] == edge[place]
    rows = np.flatnonzero(near)[innermost]
    direction = np.zeros((2, len(edge)))
    direction[:, place[innermost]] = np.stack([u[rows], v[rows]]) / rho[rows]
    return edge.reshape(-1, sectors), direction.reshape(2, -1, sectors)


def _circles(
    edge: Array, direction: Array, radius: Array, spacing_mm: float
) -> tuple[Array, Array, Array, NDArray[np.bool_], Array]:
    """Robust circles: shift of the centres (K, 2), radii (K,), scatter (K,), sectors (K, S) that lie on them, normal
    matrices (K, 3, 3) of centre and radius."""
    there = np.isfinite(edge)
    design = np.stack([direction[0], direction[1], np.ones(edge.shape)])
    answer = np.concatenate([np.zeros((len(radius), 2)), radius[:, None]], axis=1)
    scatter = np.full(len(radius), np.nan)
    weights = there.astype(np.float64)
    normal = np.zeros((len(radius), 3, 3))
    for _ in range(6):
        miss = np.where(there, edge - np.einsum("kp,pks->ks", answer, design), np.nan)
        with np.errstate(all="ignore"):
            middle = row_medians(np.abs(miss))
        scatter = np.maximum(1.4826 * np.nan_to_num(middle, nan=spacing_mm), 0.05 * spacing_mm)
        ratio = np.where(there, miss, np.inf) / (TUKEY * scatter[:, None])
        weights = np.square(1.0 - np.minimum(np.square(ratio), 1.0))
        weighted = design * weights
        normal = np.einsum("pks,qks->kpq", weighted, design) + 1e-9 * np.eye(3)
        pull = np.einsum("pks,ks->kp", weighted, np.where(there, miss, 0.0))
        answer = answer + np.linalg.solve(normal, pull[:, :, None])[:, :, 0]
    limit = 0.5 * radius[:, None]
    return (
        np.clip(answer[:, :2], -limit, limit),
        np.clip(answer[:, 2], 0.5 * radius, 2.0 * radius),
        scatter,
        weights > 0,
        normal,
    )
