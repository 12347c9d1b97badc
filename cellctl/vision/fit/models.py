"""Signed distances from circle, sphere, cylinder and cone with their derivatives, for many candidates at once.

A model takes points (..., n, 3) and parameters (..., p) with equal leading axes and gives residuals (..., m) and
Jacobian (..., m, p). An axis is four parameters: x, y where it pierces the plane z = 0 and two slopes, in a frame
whose third axis is near it (Forbes, NPL report DITC 140/89; Shakarji, J. Res. NIST 103 (1998) 633).
"""

from __future__ import annotations

import numpy as np

from cellctl.vision.fit.result import Array


def sphere(points: Array, x: Array) -> tuple[Array, Array]:
    """Sphere in space, or circle in the plane for points (..., n, 2). Parameters: centre, radius."""
    offset = points - x[..., None, :-1]
    rho = _length(offset)
    return rho - x[..., -1:], np.concatenate([-offset / rho[..., None], -np.ones_like(rho)[..., None]], axis=-1)


def circle(points: Array, x: Array) -> tuple[Array, Array]:
    """Out of the plane, then radial (m = 2 n). Parameters: x, y, slopes, z, radius."""
    axis, height, across, rho, length = _about(points, x[..., [0, 1, 4]], x[..., 2:4])
    one, nothing = np.ones_like(rho)[..., None], np.zeros_like(rho)[..., None]
    turned, outward, axis = across[..., :2] / length, across / rho[..., None], one * axis
    out = np.concatenate([-axis[..., :2], turned, -axis[..., 2:], nothing], axis=-1)
    radial = np.concatenate([-outward[..., :2], -(height / rho)[..., None] * turned, -outward[..., 2:], -one], axis=-1)
    return np.concatenate([height, rho - x[..., 5:]], axis=-1), np.concatenate([out, radial], axis=-2)


def cylinder(points: Array, x: Array) -> tuple[Array, Array]:
    """Parameters: x, y, slopes, radius."""
    _, height, across, rho, length = _about(points, _foot(x), x[..., 2:4])
    lateral = -across[..., :2] / rho[..., None]
    slopes = lateral * (height[..., None] / length)
    return rho - x[..., 4:5], np.concatenate([lateral, slopes, -np.ones_like(rho)[..., None]], axis=-1)


def cone(points: Array, x: Array) -> tuple[Array, Array]:
    """Parameters: x, y, slopes, distance (radius at height zero times the cosine of the half angle), half angle."""
    axis, height, across, rho, length = _about(points, _foot(x), x[..., 2:4])
    c, s = np.cos(x[..., 5:6]), np.sin(x[..., 5:6])
    lateral = -c[..., None] * across[..., :2] / rho[..., None]
    place = lateral + s[..., None] * axis[..., :2]
    slopes = lateral * (height[..., None] / length) - s[..., None] * across[..., :2] / length
    rest = np.stack([-np.ones_like(rho), -s * rho - c * height], axis=-1)
    return c * rho - s * height - x[..., 4:5], np.concatenate([place, slopes, rest], axis=-1)


def _about(points: Array, foot: Array, slopes: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Axis (..., 1, 3), height along it, vector and distance across it for each point, and the length of
    (slope_x, slope_y, 1) as (..., 1, 1)."""
    axis = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)[..., None, :]
    length = _length(axis)[..., None]
    axis = axis / length
    offset = points - foot[..., None, :]
    height = (offset * axis).sum(axis=-1)
    across = offset - height[..., None] * axis
    return axis, height, across, _length(across), length


def _foot(x: Array) -> Array:
    return np.concatenate([x[..., :2], np.zeros_like(x[..., :1])], axis=-1)


def _length(vectors: Array) -> Array:
    return np.asarray(np.maximum(np.sqrt((vectors * vectors).sum(axis=-1)), 1e-300))
