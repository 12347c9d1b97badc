"""Pose of the camera in one view, from the spheres of the artefact that it sees. Pure.

Least squares of the certified centres over a turn and a shift. The covariance has what repetition shows (noise of the
centres) and what it does not: ripple of the scanner, its scale, the certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellctl.calibrating.sphere_noise import repeatability, ripple
from cellctl.calibration import Scale
from cellctl.vision.geometry import Array, Points, transform
from cellctl.vision.part import Refused
from cellctl.vision.spheres import SphereFit

LEAST_SPHERES, LEAST_LOOKS = 4, 3
WORST_RESIDUAL_MM = 0.1
WORST_ROTATION_DEG = 0.02
WORST_SCALE = 2e-3
"""Beyond these the spheres do not fit their certificate, do not fix a pose, or are told in another unit."""


@dataclass(frozen=True, slots=True)
class ViewPose:
    """`T_cell_scanner` (4, 4); `covariance` (6, 6) of turns about the scanner (deg, cell x, y, z) and shifts (mm).

    `residual_mm` (n,) are the distances left between spheres and certificate, `noise_mm` the scatter of one centre per
    axis from look to look.
    """

    T_cell_scanner: Array
    covariance: Array
    residual_mm: Array
    noise_mm: float

    @property
    def sigma_rotation_deg(self) -> float:
        """Rms over the three axes."""
        return float(np.sqrt(max(np.trace(self.covariance[:3, :3]), 0.0) / 3.0))

    @property
    def sigma_translation_mm(self) -> float:
        """Rms over the three axes, of the scanner's own place."""
        return float(np.sqrt(max(np.trace(self.covariance[3:, 3:]), 0.0) / 3.0))


def view_pose(
    looks: Sequence[Sequence[SphereFit]],
    certified_mm: Array,
    start: Array,
    scale: Scale,
    *,
    sphere_diameter_mm: float,
    certificate_mm: float = 0.0,
) -> ViewPose:
    """From k >= 3 looks at n >= 4 spheres; `certified_mm` (n, 3) in the cell, `start` (4, 4) near the pose.

    Raises Refused: geometry_too_weak, wrong_unit, residual_too_large.
    """
    if len(certified_mm) < LEAST_SPHERES or len(looks) < LEAST_LOOKS:
        raise Refused(
            "geometry_too_weak",
            f"{len(looks)} looks at {len(certified_mm)} spheres; at least {LEAST_LOOKS} at {LEAST_SPHERES} are needed",
        )
    seen = np.array([[fit.center_mm for fit in look] for look in looks])
    centres = seen.mean(axis=0)
    _check_scale(centres, certified_mm)
    noise, spread_mm = repeatability(looks, seen)
    systematic = ripple(centres, scale.sigma_ripple_mm, 0.5 * sphere_diameter_mm)
    random = noise + systematic + certificate_mm**2 * np.eye(noise.shape[0])
    pose, gain = _fitted(centres, certified_mm, start, random)
    stretched = scale.sigma_scale * centres.ravel()
    total = random + np.outer(stretched, stretched)
    turned = np.kron(np.eye(len(centres)), pose[:3, :3])
    covariance = gain @ turned @ total @ turned.T @ gain.T
    to_deg = np.diag([180.0 / np.pi] * 3 + [1.0] * 3)
    residual = np.linalg.norm(transform(pose, centres) - certified_mm, axis=1)
    found = ViewPose(pose, to_deg @ covariance @ to_deg, residual, spread_mm)
    _check(found)
    return found


def require_millimetres(points: Points, low_mm: float = 50.0, high_mm: float = 5000.0) -> None:
    """Raises Refused wrong_unit for a cloud whose depth no scanner of a bench has in millimetres."""
    depth = points[..., 2]
    valid = depth[np.isfinite(depth)]
    middle = float(np.median(valid)) if valid.size else np.nan
    if not low_mm <= middle <= high_mm:
        raise Refused("wrong_unit", f"the scan's median depth is {middle:g}: millimetres of a bench were expected")


def _check_scale(centres: Array, certified: Array) -> None:
    size = [float(np.sqrt(np.sum((places - places.mean(axis=0)) ** 2))) for places in (centres, certified)]
    if not abs(size[0] / size[1] - 1.0) <= WORST_SCALE:
        raise Refused(
            "wrong_unit",
            f"the spheres lie {size[0] / size[1]:.4g} times as far apart as certified: unit or certificate is wrong",
        )


def _fitted(centres: Array, certified: Array, start: Array, noise: Array) -> tuple[Array, Array]:
    """Pose and (6, 3n) how it follows errors of the centres in the cell: Gauss-Newton, `noise` (3n, 3n) as weights."""
    pose = start.copy()
    gain = np.zeros((6, centres.size))
    for _ in range(20):
        turned = np.kron(np.eye(len(centres)), pose[:3, :3])
        weight = np.linalg.inv(turned @ (noise + 1e-12 * np.eye(centres.size)) @ turned.T)
        jacobian = np.concatenate([np.hstack([-_cross(arm), np.eye(3)]) for arm in centres @ pose[:3, :3].T])
        gain = np.linalg.solve(jacobian.T @ weight @ jacobian, jacobian.T @ weight)
        step = -gain @ (transform(pose, centres) - certified).ravel()
        pose[:3, :3] = _turn(step[:3]) @ pose[:3, :3]
        pose[:3, 3] += step[3:]
        if np.abs(step).max() < 1e-12:
            break
    return pose, gain


def _check(found: ViewPose) -> None:
    worst = int(np.argmax(found.residual_mm))
    if found.residual_mm[worst] > WORST_RESIDUAL_MM:
        raise Refused(
            "residual_too_large",
            f"sphere {worst} lies {found.residual_mm[worst]:.3f} mm off the best fit (limit {WORST_RESIDUAL_MM} mm): "
            "post or certificate is wrong",
        )
    loosest = float(np.sqrt(max(np.linalg.eigvalsh(found.covariance[:3, :3])[-1], 0.0)))
    if loosest > WORST_ROTATION_DEG:
        raise Refused(
            "geometry_too_weak",
            f"the spheres fix the view to {loosest:.3f} deg only (limit {WORST_ROTATION_DEG} deg)",
        )


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _turn(vector: Array) -> Array:
    """(3, 3) rotation by the vector (3,) in radians; orthogonal to rounding."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    k = _cross(vector / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)
