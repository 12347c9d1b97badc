"""A flange measured with Open3D and NumPy as an engineer would who knows the part and roughly where it lies.

Optional cut along z, optional statistical outlier removal, planes by RANSAC until one lies where the part was taught,
then for each hole the outline of the face around its nominal place as a circle by least squares. With `wall` the
circle goes through the bore's wall instead, which only a scan as dense as these shows. Nothing here comes from the
vision core.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

Array = NDArray[np.float64]

TAU_MM = 0.1
"""Distance up to which a point belongs to a plane."""
NEIGHBOURS, STD_RATIO = 20, 2.0
AROUND_MM = 1.5
HEIGHT_TOLERANCE_MM = 1.5
MOST_PLANES = 4


def measure(
    cloud: NDArray[np.float32], job: Mapping[str, Any], *, sor: bool = False, cut: bool = False, wall: bool = False
) -> dict[str, Any]:
    """Normal (3,) towards the scanner and centres (n, 3), None where a hole was not found. Cloud (..., 3), mm.

    Raises RuntimeError where no plane lies where the part was taught.
    """
    o3d.utility.random.seed(0)
    points = cloud.reshape(-1, 3)
    near, far = (job["near_mm"], job["far_mm"]) if cut else (0.0, np.inf)
    kept = points[(points[:, 2] > near) & (points[:, 2] < far)]  # NaN is neither
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(kept.astype(np.float64)))
    if sor:
        pcd, _ = pcd.remove_statistical_outlier(NEIGHBOURS, STD_RATIO)
    taught = np.array(job["taught"])
    face, normal = _face(pcd, taught[:3, 3])
    origin = face.mean(axis=0)
    across = taught[:3, 0] - (taught[:3, 0] @ normal) * normal
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(normal, across)])
    places = (np.array(job["places_mm"]) @ taught[:3, :2].T + taught[:3, 3] - origin) @ axes.T
    mouths = np.array(job["mouth_radii_mm"])
    windows = _around((face - origin) @ axes.T, places, mouths + AROUND_MM)
    found = [_outline(window, *hole) for window, *hole in zip(windows, places, mouths, strict=True)]
    if wall:
        off = (np.asarray(pcd.points) - origin) @ np.vstack([axes, normal]).T
        low, high = job["wall_mm"]
        inside = off[(off[:, 2] > -high) & (off[:, 2] < -low), :2]
        windows = _around(inside, places, mouths)
        found = [None if at is None else _wall(window, at) for window, at in zip(windows, found, strict=True)]
    centres = [None if at is None else (origin + at @ axes).tolist() for at in found]
    return {"normal": normal.tolist(), "centres": centres}


def _face(pcd: Any, place: Array) -> tuple[Array, Array]:
    """Points (N, 3) and normal (3,) of the first plane, the largest first, that passes through `place`."""
    for _ in range(MOST_PLANES):
        plane, inliers = pcd.segment_plane(TAU_MM, 3, 1000)
        length = np.linalg.norm(plane[:3])
        if abs(plane[:3] @ place + plane[3]) < HEIGHT_TOLERANCE_MM * length:
            normal = plane[:3] / length
            return np.asarray(pcd.points)[inliers], -normal if normal[2] > 0 else normal
        pcd = pcd.select_by_index(inliers, invert=True)
    raise RuntimeError("no plane lies where the part was taught")


def _around(flat: Array, places: Array, reaches: Array) -> list[Array]:
    """The points (k, 2) within reach of each place, looked up in the ring of all places only."""
    middle = places.mean(axis=0)
    far = np.hypot(*(places - middle).T)
    rho = np.hypot(*(flat - middle).T)
    ring = flat[(rho > (far - reaches).min()) & (rho < (far + reaches).max())]
    return [ring[np.hypot(*(ring - place).T) < reach] for place, reach in zip(places, reaches, strict=True)]


def _outline(window: Array, place: Array, mouth: float) -> Array | None:
    """Centre (2,) of the circle through the outline: in each sector the face point nearest to the hole's middle.

    The sectors are two points wide, as the density of the face says.
    """
    spacing = np.sqrt(np.pi * ((mouth + AROUND_MM) ** 2 - mouth**2) / max(len(window), 1))
    sectors = max(8, int(np.pi * mouth / spacing))
    centre = place
    for _ in range(3):
        away = window - centre
        rho = np.hypot(*away.T)
        sector = ((np.arctan2(away[:, 1], away[:, 0]) / (2.0 * np.pi) + 0.5) * sectors).astype(int) % sectors
        order = np.lexsort((rho, sector))
        _, first = np.unique(sector[order], return_index=True)
        outline = window[order[first]]
        if len(outline) < max(6, sectors // 3):
            return None
        centre = _robust_circle(outline)
    return centre


def _wall(window: Array, centre: Array) -> Array | None:
    """Centre (2,) of the circle through the points of the bore's wall, seen along the face's normal."""
    if len(window) < 12:
        return None
    for _ in range(3):
        rho = np.hypot(*(window - centre).T)
        near = np.abs(rho - np.median(rho)) < 0.5
        centre = _robust_circle(window[near])
    return centre


def _robust_circle(points: Array) -> Array:
    """Centre of the circle by least squares, once more without what is beyond three robust sigma."""
    centre, radius = _circle(points)
    off = np.abs(np.hypot(*(points - centre).T) - radius)
    return _circle(points[off < 3.0 * 1.4826 * np.median(off) + 1e-9])[0]


def _circle(points: Array) -> tuple[Array, float]:
    """Circle by orthogonal least squares: algebraic start, then Gauss-Newton."""
    solution = np.linalg.lstsq(np.column_stack([2.0 * points, np.ones(len(points))]), (points**2).sum(axis=1))[0]
    centre, radius = solution[:2], float(np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 1e-9)))
    for _ in range(10):
        away = points - centre
        rho = np.hypot(*away.T)
        step = np.linalg.lstsq(np.column_stack([away / rho[:, None], np.ones(len(rho))]), rho - radius)[0]
        centre, radius = centre + step[:2], radius + float(step[2])
        if np.abs(step).max() < 1e-7:
            break
    return centre, radius
