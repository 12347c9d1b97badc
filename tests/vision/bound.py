"""The bound on a hole's centre: Fisher information of the points delivered, labels known, white noise along the ray.

Nuisance parameters free: radius of chamfer and wall, tilt of the hole within its own scatter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import inverse, transform
from tests.vision.synthetic import View, render, true_centres

Array = NDArray[np.float64]


def centre_bound_mm(view: View, tilt_sigma_rad: float) -> float:
    """Rms over the holes of the 2-D standard deviation of the centre that no estimator beats."""
    clean = replace(view, sigma_mm=0.0, outliers=0.0, ripple_mm=0.0, clutter=False)
    cloud = render(clean, np.random.default_rng(0)).reshape(-1, 3).astype(np.float64)
    cloud = cloud[np.isfinite(cloud[:, 0])]
    local = transform(inverse(view.T_scanner_part), cloud)
    rays = cloud / np.linalg.norm(cloud, axis=1, keepdims=True) @ view.T_scanner_part[:3, :3]
    part = view.part
    slope = np.tan(np.radians(part.chamfer_angle_deg or 45.0))
    cosine = 1.0 / np.sqrt(1.0 + slope**2)
    total = []
    for index, centre in enumerate(true_centres(view)):
        wall, mouth = 0.5 * (part.diameter_mm or ())[index], 0.5 * (part.chamfer_diameter_mm or 0.0)
        q = local - centre
        tilt = np.zeros(2) if view.tilts_rad is None else view.tilts_rad[index]
        flat = q[:, :2] - q[:, 2:] * tilt
        rho = np.hypot(*flat.T)
        inside = (rho < mouth + 0.01) & (q[:, 2] < -1e-3) & (q[:, 2] > -(part.depth_mm or 14.0) - 0.01)
        flat, rho, height, ray = flat[inside], rho[inside], q[inside, 2], rays[inside]
        out = np.column_stack([flat / rho[:, None], np.zeros(len(rho))])
        cone = np.abs(rho - mouth - slope * height) < 0.01
        on_wall = ~cone & (np.abs(rho - wall) < 0.01)
        normal = np.where(cone[:, None], cosine * out - [0.0, 0.0, slope * cosine], out)
        seen = np.abs((normal * ray).sum(axis=1)) * view.sigma_mm
        scale = np.where(cone, cosine, 1.0)
        design = np.column_stack([
            out[:, 0] * scale, out[:, 1] * scale, cone * cosine, on_wall * 1.0,
            out[:, 0] * scale * height, out[:, 1] * scale * height,
        ])  # fmt: skip
        used = cone | on_wall
        fisher = (design[used] / seen[used, None] ** 2).T @ design[used]
        fisher[4:, 4:] += np.eye(2) / tilt_sigma_rad**2
        total.append(np.trace(np.linalg.inv(fisher)[:2, :2]))
    return float(np.sqrt(np.mean(total)))
