"""The bound: Fisher information of the points delivered, labels known, white noise along the ray, true geometry.

Nuisance parameters are free: radius of chamfer and wall of every hole; how a hole leans is held by the scatter of the
leans themselves, as far as the part has any (infinite information where every hole stands square).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import inverse, transform
from tests.vision.synthetic import View, render, true_centres

Array = NDArray[np.float64]
SQUARE_RAD = 1e-9
LABEL_MM = 2e-4  # rounding of float32 at these distances, with room


@dataclass(frozen=True)
class Bound:
    """Standard deviations that no estimator beats: rms over the holes of the 2-D centre and of the radius, clocking,
    rms of the normal's two tilts, and offset of the face at the middle of its points."""

    centre_mm: float
    radius_mm: float
    clocking_deg: float
    normal_deg: float
    offset_mm: float


@dataclass(frozen=True)
class Inside:
    """Noise-free points in one hole: offsets (m, 3) from its centre on the face, rays (m, 3), which lie on the cone."""

    points: Array
    rays: Array
    cone: NDArray[np.bool_]
    slope: float
    wall_mm: float
    mouth_mm: float


def bound(view: View, tilt_sigma_rad: float = SQUARE_RAD) -> Bound:
    """The bound of a view; its seed decides which pixels are lost, here those of seed 0."""
    local, rays = _clean(view)
    centres, radii = [], []
    for hole in _insides(view, local, rays):
        covariance = np.linalg.inv(information(hole, view.sigma_mm, tilt_sigma_rad))
        centres.append(covariance[:2, :2])
        radii.append(covariance[3, 3])
    on_face = np.abs(local[:, 2]) < 1e-4
    face = _face_information(local[on_face], rays[on_face], view.sigma_mm)
    design = np.zeros((len(centres), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    places = true_centres(view)
    design[:, 0, 2], design[:, 1, 2] = -places[:, 1], places[:, 0]
    pose = np.linalg.inv(np.einsum("nij,nik,nkl->jl", design, np.linalg.inv(np.array(centres)), design))
    return Bound(
        centre_mm=float(np.sqrt(np.mean([np.trace(covariance) for covariance in centres]))),
        radius_mm=float(np.sqrt(np.mean(radii))),
        clocking_deg=float(np.degrees(np.sqrt(pose[2, 2]))),
        normal_deg=float(np.degrees(np.sqrt(np.trace(face[1:, 1:]) / 2.0))),
        offset_mm=float(np.sqrt(face[0, 0])),
    )


def centre_bound_mm(view: View, tilt_sigma_rad: float = SQUARE_RAD) -> float:
    """Rms over the holes of the 2-D standard deviation of the centre."""
    return bound(view, tilt_sigma_rad).centre_mm


def insides(view: View) -> Iterator[Inside]:
    """The points in every hole, without noise."""
    return _insides(view, *_clean(view))


def information(hole: Inside, sigma_mm: float, tilt_sigma_rad: float) -> Array:
    """Fisher information (6, 6) of centre u, v, chamfer, wall, lean u, v."""
    rho = np.hypot(hole.points[:, 0], hole.points[:, 1])
    out = np.column_stack([hole.points[:, :2] / rho[:, None], np.zeros(len(rho))])
    cosine = 1.0 / np.sqrt(1.0 + hole.slope**2)
    scale = np.where(hole.cone, cosine, 1.0)
    normal = np.where(hole.cone[:, None], cosine * out - [0.0, 0.0, hole.slope * cosine], out)
    across = np.abs((normal * hole.rays).sum(axis=1)) * sigma_mm
    height = hole.points[:, 2]
    design = np.column_stack([
        out[:, 0] * scale, out[:, 1] * scale, hole.cone * cosine, ~hole.cone * 1.0,
        out[:, 0] * scale * height, out[:, 1] * scale * height,
    ])  # fmt: skip
    fisher = (design / across[:, None] ** 2).T @ design
    fisher[4:, 4:] += np.eye(2) / tilt_sigma_rad**2
    return np.asarray(fisher)


def _clean(view: View) -> tuple[Array, Array]:
    """Noise-free points (N, 3) in the part frame and the rays (N, 3) they lie on."""
    clean = replace(view, sigma_mm=0.0, outliers=0.0, ripple_mm=0.0, clutter=False)
    cloud = render(clean, np.random.default_rng(0)).reshape(-1, 3).astype(np.float64)
    cloud = cloud[np.isfinite(cloud[:, 0])]
    rays = cloud / np.linalg.norm(cloud, axis=1, keepdims=True) @ view.T_scanner_part[:3, :3]
    return transform(inverse(view.T_scanner_part), cloud), rays


def _insides(view: View, local: Array, rays: Array) -> Iterator[Inside]:
    part = view.part
    slope = float(np.tan(np.radians(part.chamfer_angle_deg or 45.0)))
    for index, centre in enumerate(true_centres(view)):
        wall, mouth = 0.5 * (part.diameter_mm or ())[index], 0.5 * (part.chamfer_diameter_mm or 0.0)
        q = local - centre
        tilt = np.zeros(2) if view.tilts_rad is None else view.tilts_rad[index]
        flat = q[:, :2] - q[:, 2:] * tilt
        rho = np.hypot(*flat.T)
        inside = (rho < mouth + 0.01) & (q[:, 2] < -1e-3) & (q[:, 2] > -(part.depth_mm or 14.0) - 0.01)
        cone = np.abs(rho - mouth - slope * q[:, 2]) < LABEL_MM
        used = inside & (cone | (np.abs(rho - wall) < LABEL_MM))
        points = np.column_stack([flat[used], q[used, 2]])
        yield Inside(points, rays[used], cone[used], slope, wall, mouth)


def _face_information(points: Array, rays: Array, sigma_mm: float) -> Array:
    """Covariance (3, 3) of offset and two slopes of the face about the middle of its points."""
    offset = points[:, :2] - points[:, :2].mean(axis=0)
    design = np.column_stack([np.ones(len(offset)), offset]) / (sigma_mm * np.abs(rays[:, 2]))[:, None]
    return np.asarray(np.linalg.inv(design.T @ design))
