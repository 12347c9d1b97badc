"""Start values from algebraic fits along many directions: points (n, 3) are centred and of order one.

Each gives frames (b, 3, 3), whose rows are the axes of a frame, and parameters (b, p) of the model in that frame.
"""

from __future__ import annotations

import numpy as np

from cellctl.vision.fit.result import Array, frame_of, principal

DIRECTIONS = 150
AWAY = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Distances of a centre from the points, in units of their spread."""


def spheres(points: Array) -> tuple[Array, Array]:
    """The algebraic sphere, and some on either side of the points' plane; in two dimensions circles likewise."""
    size = points.shape[1]
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    centre = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=1e-13)[0][:size]
    thin = np.linalg.eigh(points.T @ points)[1][:, 0]
    aside = np.outer([-a for a in AWAY] + list(AWAY), thin)
    centres = np.vstack([centre, aside])
    radii = np.linalg.norm(points - centres[:, None, :], axis=2).mean(axis=1)
    return np.broadcast_to(np.eye(size), (len(centres), size, size)), np.column_stack([centres, radii])


def circles(points: Array) -> tuple[Array, Array]:
    """The algebraic circle and some on either side, in planes turned about the points' greatest length."""
    _, _, (thin, wide, long) = principal(points)
    turns = np.pi * np.arange(6) / 6.0
    frames = frame_of(np.outer(np.cos(turns), thin) + np.outer(np.sin(turns), wide))
    local = points @ np.swapaxes(frames, 1, 2)
    x, y, radius = circles_in_planes(local).T
    nothing = np.zeros(len(turns))
    found = [np.column_stack([x, y, nothing, nothing, nothing, radius])]
    side = np.cross(frames[:, 2], long)
    for away in AWAY:
        for way in (-away, away):
            centre = (frames @ (way * side)[..., None])[..., 0]
            radius = np.linalg.norm(local - centre[:, None, :], axis=2).mean(axis=1)
            found.append(np.column_stack([centre[:, :2], nothing, nothing, centre[:, 2], radius]))
    return np.concatenate([frames] * len(found)), np.concatenate(found)


def circles_in_planes(local: Array) -> Array:
    """Centre and radius (b, 3) of the algebraic circle (Kasa) through the x, y of points (b, n, 3)."""
    flat = local[..., :2]
    design = np.concatenate([2.0 * flat, np.ones_like(flat[..., :1])], axis=-1)
    found = (np.linalg.pinv(design, rcond=1e-12) @ (flat**2).sum(axis=-1)[..., None])[..., 0]
    radius = np.sqrt(np.maximum(found[:, 2] + (found[:, :2] ** 2).sum(axis=1), 1e-12))
    return np.column_stack([found[:, :2], radius])


def hemisphere(points: Array) -> Array:
    """Frames (b, 3, 3) along directions spread evenly over half a sphere (Fibonacci lattice) and the principal ones."""
    index = np.arange(DIRECTIONS) + 0.5
    z = 1.0 - index / DIRECTIONS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    rho = np.sqrt(1.0 - z * z)
    spread = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])
    return frame_of(np.vstack([spread, principal(points)[2]]))


def cylinders(points: Array) -> tuple[Array, Array]:
    """Algebraic circles along many directions: x, y, slopes, radius."""
    frames = hemisphere(points)
    x, y, radius = circles_in_planes(points @ np.swapaxes(frames, 1, 2)).T
    return frames, np.column_stack([x, y, 0.0 * x, 0.0 * x, radius])


def cones(points: Array) -> tuple[Array, Array]:
    """Cones along many directions by a fit that is linear in its quadric's terms: x, y, slopes, distance, half angle.

    With the axis given: x^2 + y^2 = 2 cx x + 2 cy y + A + B z + C z^2, where the radius is r0 + t z, C = t^2.
    """
    frames = hemisphere(points)
    local = points @ np.swapaxes(frames, 1, 2)
    flat, height = local[..., :2], local[..., 2:]
    design = np.concatenate([2.0 * flat, np.ones_like(height), height, height**2], axis=-1)
    square = (flat**2).sum(axis=-1)[..., None]
    centre = (np.linalg.pinv(design, rcond=1e-12) @ square)[:, :2, 0]
    rho = np.linalg.norm(flat - centre[:, None, :], axis=2)
    mean, slope = rho.mean(axis=1), (rho * height[..., 0]).sum(axis=1) / ((height**2).sum(axis=(1, 2)) + 1e-12)
    half = np.arctan(slope)
    return frames, np.column_stack([centre, 0.0 * half, 0.0 * half, mean * np.cos(half), half])
