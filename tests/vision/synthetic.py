"""Exact clouds of a chamfered, drilled annular face as a pinhole camera sees it: every pixel's ray meets the surface.

Scanner frame: pinhole at the origin, z away from the camera. Independent of the twin's scene on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Part

Array = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """What is rendered and how. `T_scanner_part` (4, 4); hole offsets in the part frame, (n, 2) mm and (n, 2) rad."""

    part: Part
    T_scanner_part: Array
    pixels: int = 700
    field_mm: float = 320.0
    sigma_mm: float = 0.03
    correlation_px: float = 0.0
    ripple_mm: float = 0.0
    outliers: float = 0.02
    lost: float = 0.02
    clutter: bool = True
    angles_deg: Array | None = None
    offsets_mm: Array | None = None
    tilts_rad: Array | None = None
    missing: tuple[int, ...] = field(default=())


def pose_above(distance_mm: float = 350.0, tilt: tuple[float, float] = (0.0, 0.0), turn: float = 0.0,
               shift: tuple[float, float] = (0.0, 0.0)) -> Array:  # fmt: skip
    """Pose of a part that faces the scanner: part z towards the camera, tilted and turned (radians), shifted (mm)."""
    cz, sz = np.cos(turn), np.sin(turn)
    cx, sx = np.cos(tilt[0]), np.sin(tilt[0])
    cy, sy = np.cos(tilt[1]), np.sin(tilt[1])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ rx @ ry @ rz
    pose[:3, 3] = [shift[0], shift[1], distance_mm]
    return pose


def true_centres(view: View) -> Array:
    """Hole centres (n, 3) on the face in the part frame."""
    angles = np.radians(view.part.angles_deg)
    centres = 0.5 * view.part.circle_diameter_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    if view.offsets_mm is not None:
        centres = centres + view.offsets_mm
    return np.column_stack([centres, np.zeros(len(centres))])


def render(view: View, rng: np.random.Generator) -> NDArray[np.float32]:
    """Cloud (pixels, pixels, 3) in the scanner frame."""
    n, distance = view.pixels, float(view.T_scanner_part[2, 3])
    steps = ((np.arange(n) + 0.5) / n - 0.5) * view.field_mm / distance
    directions = np.dstack([*np.meshgrid(steps, steps), np.ones((n, n))])
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    rotation = view.T_scanner_part[:3, :3]
    origin = -rotation.T @ view.T_scanner_part[:3, 3]
    rays = directions.reshape(-1, 3) @ rotation
    depth = _cast(view, origin, rays)
    depth += view.ripple_mm * np.sin(rays[:, 0] / -rays[:, 2] * distance / 13.0 + 0.4)
    depth += view.sigma_mm * _noise(view, rng).ravel()
    if view.outliers:
        wrong = rng.random(n * n) < view.outliers
        depth[wrong] += rng.uniform(-15.0, 15.0, np.count_nonzero(wrong))
    depth[rng.random(n * n) < view.lost] = np.nan
    return (directions * depth.reshape(n, n, 1)).astype(np.float32)


def _noise(view: View, rng: np.random.Generator) -> Array:
    white = rng.standard_normal((view.pixels, view.pixels))
    if not view.correlation_px:
        return white
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(white, view.correlation_px / 2.0, mode="wrap")
    return np.asarray(smooth / smooth.std())


def _cast(view: View, origin: Array, rays: Array) -> Array:
    """Depth along each ray (N,), NaN where nothing is met. Part frame."""
    part = view.part
    r_in, r_out = 0.5 * (part.face_inner_diameter_mm or 0.0), 0.5 * (part.face_outer_diameter_mm or 1e9)
    depth = np.full(len(rays), np.nan)
    for height, inner, outer in (
        (-60.0, 0.0, 1e9 if view.clutter else 0.0),
        (-(part.ledge_step_mm or 5.0), r_out, r_out + 15.0),
    ):
        t = (height - origin[2]) / rays[:, 2]
        rho = np.hypot(*(origin[:2] + t[:, None] * rays[:, :2]).T)
        hit = (rho >= inner) & (rho < outer)
        depth[hit] = t[hit]
    t = -origin[2] / rays[:, 2]
    at = origin[:2] + t[:, None] * rays[:, :2]
    on = (np.hypot(*at.T) >= r_in) & (np.hypot(*at.T) < r_out)
    depth[on] = t[on]
    for index, centre in enumerate(true_centres(view)):
        if index in view.missing:
            continue
        diameter = part.diameter_mm[index] if part.diameter_mm else 8.3
        chamfer = part.chamfer_diameter_mm or diameter
        tilt = np.zeros(2) if view.tilts_rad is None else view.tilts_rad[index]
        near = np.flatnonzero(on & (np.hypot(*(at - centre[:2]).T) < chamfer))
        hits, kept = _hole(origin - centre, rays[near], t[near], 0.5 * diameter, 0.5 * chamfer,
                           np.tan(np.radians(part.chamfer_angle_deg or 45.0)), part.depth_mm or 14.0, tilt)  # fmt: skip
        depth[near[kept]] = hits[kept]
    if view.clutter:  # a clamp that stands on the face's edge
        t = (12.0 - origin[2]) / rays[:, 2]
        at = origin[:2] + t[:, None] * rays[:, :2]
        clamp = (np.abs(at[:, 0]) < 9.0) & (at[:, 1] > r_out - 6.0) & (at[:, 1] < r_out + 30.0)
        depth[clamp] = t[clamp]
    return depth


def _hole(origin: Array, rays: Array, t0: Array, wall: float, chamfer: float, slope: float, deep: float, tilt: Array
          ) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """Depths inside one hole: first wall of cone or cylinder met below the mouth. Axis shears by `tilt` with depth."""
    shear = rays[:, :2] - rays[:, 2:] * tilt
    base = origin[:2] - origin[2] * tilt

    def far_root(k: float, r0: float) -> Array:
        radius0, dradius = r0 + k * origin[2], k * rays[:, 2]
        a = (shear**2).sum(axis=1) - dradius**2
        b = shear @ base - radius0 * dradius
        c = base @ base - radius0**2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        roots = np.stack([(-b - root) / a, (-b + root) / a])
        roots[roots < t0 - 1e-9] = np.inf
        return np.asarray(roots.min(axis=0))

    inside = np.hypot(*(base + t0[:, None] * shear).T) < chamfer
    bottom = -(chamfer - wall) / slope
    cone = far_root(slope, chamfer) if chamfer > wall else np.full(len(rays), np.inf)
    on_cone = origin[2] + cone * rays[:, 2] > bottom
    cylinder = far_root(0.0, wall)
    # from below the cone the ray is inside the cylinder: its far wall is the exit
    a, b = (shear**2).sum(axis=1), shear @ base
    exit_ = (-b + np.sqrt(np.maximum(b * b - a * (base @ base - wall**2), 0.0))) / a
    hit = np.where(on_cone, cone, np.where(np.isfinite(cylinder), exit_, np.inf))
    hit[origin[2] + hit * rays[:, 2] < -deep] = np.nan
    hit[~np.isfinite(hit)] = np.nan
    return hit, inside
