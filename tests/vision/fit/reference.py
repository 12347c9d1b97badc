"""Point sets whose least-squares element is known exactly (Forbes, NPL DITC 140/89; Cox & Forbes, DITC 211/92).

Points on an element are moved along their normals by residuals from the null space of J^T. Moving a point along its
normal leaves J as it is, so the element stays the exact stationary point, and for small residuals the minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Known:
    """Points (N, 3) and what the fit must give. `point` is the centre, or any point on axis or plane."""

    points: Array
    point: Array
    direction: Array
    radius: float
    apex_deg: float = 0.0


def orientation(rng: np.random.Generator) -> Array:
    """A random rotation (3, 3); its rows are the frame, the last one the axis."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def in_null_space(rng: np.random.Generator, design: Array, size: float) -> Array:
    """Residuals (m,) of root mean square `size` with design^T r = 0."""
    basis, _ = np.linalg.qr(design)
    raw = rng.standard_normal(len(design))
    raw -= basis @ (basis.T @ raw)
    raw -= basis @ (basis.T @ raw)
    return np.asarray(raw * size / np.sqrt(np.mean(raw**2)))


def angles(rng: np.random.Generator, count: int, arc_deg: float) -> Array:
    """`count` angles spread over an arc, its ends included."""
    inner = rng.uniform(0.0, arc_deg, count - 2)
    return np.radians(np.concatenate([[0.0, arc_deg], inner])) + rng.uniform(0.0, 2.0 * np.pi)


def axial(rng: np.random.Generator, kind: str, size: float) -> Known:
    """Cylinder or cone: 8 to 50 points within 500 mm, arcs from 60 degrees to the full turn."""
    count, radius = int(rng.integers(8, 51)), float(rng.uniform(5.0, 150.0))
    length = float(rng.uniform(0.5, 2.0) * radius)
    turn = angles(rng, count, float(rng.choice([60.0, 90.0, 180.0, 360.0])))
    height = np.concatenate([[-0.5, 0.5], rng.uniform(-0.5, 0.5, count - 2)]) * length
    height = height[rng.permutation(count)]
    half = np.radians(rng.uniform(3.0, 35.0)) if kind == "cone" else 0.0
    out = np.column_stack([np.cos(turn), np.sin(turn)])
    rho = radius + height * np.tan(half)
    along = np.cos(half) * height + np.sin(half) * rho
    design = np.column_stack([out, out * along[:, None], np.ones(count)])
    if kind == "cone":
        design = np.column_stack([design, np.cos(half) * height + np.sin(half) * rho])
    residuals = in_null_space(rng, design, size)
    local = np.column_stack([out * (rho + residuals * np.cos(half))[:, None], height - residuals * np.sin(half)])
    frame, origin = orientation(rng), rng.uniform(-200.0, 200.0, 3)
    return Known(local @ frame + origin, origin, frame[2], radius, 2.0 * float(np.degrees(half)))


def circle(rng: np.random.Generator, size: float) -> Known:
    """Circle in space: out-of-plane and radial residuals."""
    count, radius = int(rng.integers(8, 51)), float(rng.uniform(5.0, 200.0))
    turn = angles(rng, count, float(rng.choice([45.0, 90.0, 180.0, 360.0])))
    out = np.column_stack([np.cos(turn), np.sin(turn)])
    one, nothing = np.ones((count, 1)), np.zeros((count, 1))
    plane = np.hstack([one, out])
    radial = in_null_space(rng, np.hstack([out, one]), size)
    height = in_null_space(rng, plane, size)
    local = np.hstack([out * (radius + radial)[:, None], height[:, None] + nothing])
    frame, origin = orientation(rng), rng.uniform(-200.0, 200.0, 3)
    return Known(local @ frame + origin, origin, frame[2], radius)


def sphere(rng: np.random.Generator, size: float) -> Known:
    """Sphere seen on a cap from 60 degrees to all of it."""
    count, radius = int(rng.integers(8, 51)), float(rng.uniform(5.0, 200.0))
    cap = np.radians(float(rng.choice([30.0, 60.0, 90.0, 180.0])))
    z = rng.uniform(np.cos(cap), 1.0, count)
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    out = np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    residuals = in_null_space(rng, np.hstack([out, np.ones((count, 1))]), size)
    frame, origin = orientation(rng), rng.uniform(-200.0, 200.0, 3)
    return Known((out * (radius + residuals)[:, None]) @ frame + origin, origin, frame[2], radius)


def flat(rng: np.random.Generator, kind: str, size: float) -> Known:
    """Plane or line."""
    count = int(rng.integers(8, 51))
    frame, origin = orientation(rng), rng.uniform(-200.0, 200.0, 3)
    if kind == "plane":
        across = rng.uniform(-150.0, 150.0, (count, 2))
        height = in_null_space(rng, np.column_stack([np.ones(count), across]), size)
        return Known(np.column_stack([across, height]) @ frame + origin, origin, frame[2], 0.0)
    along = rng.uniform(-150.0, 150.0, count)
    design = np.column_stack([np.ones(count), along])
    local = np.column_stack([in_null_space(rng, design, size), in_null_space(rng, design, size), along])
    return Known(local @ frame + origin, origin, frame[2], 0.0)
