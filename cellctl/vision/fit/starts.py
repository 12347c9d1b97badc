"""Start values from algebraic fits along many directions: points are centred and of order one."""

from __future__ import annotations

import numpy as np

from cellctl.vision.fit.result import Array, frame_of, principal

DIRECTIONS = 150
KEPT = 6


def circle_in_plane(points: Array) -> tuple[float, float, float]:
    """Centre and radius of the algebraic circle (Kasa) through points (N, 2)."""
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    x, y, c = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=1e-13)[0]
    return float(x), float(y), float(np.sqrt(max(c + x * x + y * y, 1e-12)))


def hemisphere(points: Array) -> list[Array]:
    """Directions spread evenly over half a sphere (Fibonacci lattice), then the principal ones of the points."""
    index = np.arange(DIRECTIONS) + 0.5
    z = 1.0 - index / DIRECTIONS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    rho = np.sqrt(1.0 - z * z)
    spread = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])
    return [*spread, *principal(points)[2]]


def cylinder_starts(points: Array) -> list[tuple[Array, Array]]:
    """The best few (direction, [x, y, 0, 0, radius]) by the geometric residual of an algebraic circle."""
    scored = []
    for direction in hemisphere(points):
        flat = (points @ frame_of(direction).T)[:, :2]
        x, y, radius = circle_in_plane(flat)
        cost = float(((np.hypot(flat[:, 0] - x, flat[:, 1] - y) - radius) ** 2).sum())
        scored.append((cost, direction, np.array([x, y, 0.0, 0.0, radius])))
    return _distinct(scored)


def cone_starts(points: Array) -> list[tuple[Array, Array]]:
    """The best few (direction, [x, y, 0, 0, distance, half angle]) by a cone that is linear in its quadric's terms.

    With the axis given: x^2 + y^2 = 2 cx x + 2 cy y + A + B z + C z^2, where the radius is r0 + t z, C = t^2.
    """
    scored = []
    for direction in hemisphere(points):
        u, v, w = (points @ frame_of(direction).T).T
        design = np.column_stack([2.0 * u, 2.0 * v, np.ones(len(u)), w, w * w])
        x, y, *_ = np.linalg.lstsq(design, u * u + v * v, rcond=1e-12)[0]
        rho = np.hypot(u - x, v - y)
        taper, radius = np.polyfit(w, rho, 1) if np.ptp(w) > 1e-9 else (0.0, rho.mean())
        half = float(np.arctan(taper))
        cost = float((((rho - radius - taper * w) * np.cos(half)) ** 2).sum())
        scored.append((cost, direction, np.array([x, y, 0.0, 0.0, float(radius) * np.cos(half), half])))
    return _distinct(scored)


def _distinct(scored: list[tuple[float, Array, Array]]) -> list[tuple[Array, Array]]:
    """The cheapest starts that lie at least some 15 degrees apart."""
    kept: list[tuple[Array, Array]] = []
    for _, direction, start in sorted((item for item in scored if np.isfinite(item[0])), key=lambda item: item[0]):
        if all(abs(float(direction @ other)) < 0.966 for other, _ in kept):
            kept.append((direction, start))
        if len(kept) == KEPT:
            break
    return kept
