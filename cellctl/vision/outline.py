"""A circle through the outline of a hole in the face: the fallback where neither wall nor chamfer was seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellctl.vision.geometry import Array

# an edge scatters with long tails that still carry its place: cut later than where noise is normal
EDGE_TUKEY = 6.0


@dataclass(frozen=True, slots=True)
class Outline:
    """Circle (centre (2,), radius) in the face, `covariance` (2, 2) of the centre, and how the outline looks.

    `arc` is the share of the outline that was seen, `fill` the share of the disk that is covered by face points.
    """

    centre_mm: Array
    radius_mm: float
    covariance: Array
    scatter_mm: float
    arc: float
    fill: float
    points: int


def fit_outline(
    uv: Array, start: Array, radius_mm: float, spacing_mm: float, *, radius_sigma_mm: float = float("inf")
) -> Outline | None:
    """Robust circle through the innermost face points (N, 2) of each sector around `start`; None where there is none.

    Limited by the sampling: an edge lies anywhere within one spacing of the innermost point. The radius is corrected
    by half a spacing, which is what the innermost point of a sector stands off on average. With `radius_sigma_mm`
    the radius (before that correction) is held to `radius_mm` as that well known: a torn outline needs it.
    """
    centre, radius = start.astype(np.float64), radius_mm
    sectors = int(np.clip(2.0 * np.pi * radius_mm / (1.1 * spacing_mm), 12, 180))
    covariance, scatter, kept, edge = np.eye(2), np.nan, np.zeros(0, dtype=np.bool_), np.zeros((0, 2))
    for _ in range(15):
        edge = _edge(uv, centre, radius, sectors)
        if len(edge) < max(8, sectors // 4):
            return None
        for _ in range(5):
            offset = edge - centre
            rho = np.hypot(*offset.T)
            residual = rho - radius
            scatter = max(1.4826 * float(np.median(np.abs(residual))), 0.05 * spacing_mm)
            weights = np.clip(1.0 - (residual / (EDGE_TUKEY * scatter)) ** 2, 0.0, None) ** 2
            kept = weights > 0.0
            if np.count_nonzero(kept) < 8:
                return None
            design = np.column_stack([offset / rho[:, None], np.ones(len(edge))])
            hold = (scatter / radius_sigma_mm) ** 2
            normal = (design * weights[:, None]).T @ design + np.diag([0.0, 0.0, hold])
            pull = design.T @ (weights * residual) + np.array([0.0, 0.0, hold * (radius_mm - radius)])
            change = np.linalg.lstsq(normal, pull, rcond=None)[0]
            centre, radius = centre + change[:2], float(radius + change[2])
            covariance = np.linalg.pinv(normal)[:2, :2] * float((weights * residual**2).sum() / weights.sum())
        if np.abs(change).max() < 1e-5:
            break
    # neighbouring sectors often take the same run of pixels: about every second one is independent
    inside = np.hypot(*(uv - centre).T)
    expected = np.pi * (0.8 * radius) ** 2 / spacing_mm**2
    return Outline(
        centre_mm=centre,
        radius_mm=radius - 0.5 * spacing_mm,
        covariance=2.0 * covariance,
        scatter_mm=scatter,
        arc=float(np.count_nonzero(kept)) / sectors,
        fill=float(np.count_nonzero(inside < 0.8 * radius)) / max(expected, 1.0),
        points=int(np.count_nonzero(kept)),
    )


def _edge(uv: Array, centre: Array, radius: float, sectors: int) -> Array:
    """The innermost face point (n, 2) of every sector that has one near the outline."""
    offset = uv - centre
    rho = np.hypot(*offset.T)
    near = (rho > 0.6 * radius) & (rho < 1.45 * radius)
    offset, rho, chosen = offset[near], rho[near], uv[near]
    sector = np.floor((np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) % 1.0) * sectors).astype(np.int64)
    order = np.lexsort((rho, sector))
    _, first = np.unique(sector[order], return_index=True)
    return np.asarray(chosen[order[first]])
