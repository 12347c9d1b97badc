"""Through-holes: mouth, chamfer cone and wall, met in closed form in each hole's own frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.hits import FLAT, ROUND, HitBuffer, Mask
from hal.fake.scene.shapes import Holes, PartShape, frame_on

Array = NDArray[np.float64]


def hole_hits(hits: HitBuffer, T_camera_part: Array, shape: PartShape) -> None:
    """Open the face where the holes are and add their chamfers and walls."""
    holes = shape.holes
    if holes is None:
        return
    R, t = T_camera_part[:3, :3], T_camera_part[:3, 3]
    center = np.column_stack([holes.center_mm, np.zeros(len(holes.center_mm))]) @ R.T + t
    frames = frame_on(holes.axis) @ R.T
    reach = holes.mouth_radius_mm * 1.1 + 0.5
    slopes = center[:, :2] / center[:, 2:]
    pixels, k = hits.camera.windows(slopes - (reach / center[:, 2])[:, None], slopes + (reach / center[:, 2])[:, None])
    ray = hits.rays(pixels)
    face_depth = (R[:, 2] @ t) / (ray @ R[:, 2])
    local_ray = np.einsum("nij,nj->ni", frames[k], ray)
    q = np.einsum("nij,nj->ni", frames[k], face_depth[:, None] * ray - center[k])
    mouth = _width(holes, k, q[:, 2]) > np.hypot(q[:, 0], q[:, 1])
    pixels, k, local_ray, q = pixels[mouth], k[mouth], local_ray[mouth], q[mouth]
    face_depth, frame = face_depth[mouth], frames[k]
    hits.depth[pixels[(hits.owner[pixels] == FLAT) & (hits.depth[pixels] > face_depth - 1e-6)]] = np.inf

    go_on, normal, on_wall = _inside(holes, k, q, local_ray)
    met = np.isfinite(go_on)
    p = q + np.where(met, go_on, 0.0)[:, None] * local_ray
    dark = np.zeros(len(pixels), dtype=np.bool_)
    for eye in hits.camera.eyes_mm:
        e = np.einsum("nij,nj->ni", frame, np.asarray(eye) - center[k])
        dark |= on_wall & ~_sees_out(holes, k, p, e)
    outward = np.einsum("nji,nj->ni", frame, normal)
    hits.keep(pixels[met], (face_depth + go_on)[met], outward[met], ROUND, dark[met])


def _width(holes: Holes, k: NDArray[np.intp], z: Array) -> Array:
    """Radius of the chamfer cone at z in the hole's frame."""
    return np.asarray(holes.mouth_radius_mm[k] + z * holes.chamfer_tan)


def _throat(holes: Holes, k: NDArray[np.intp]) -> Array:
    """z at which the chamfer ends and the wall begins."""
    return np.asarray((holes.radius_mm[k] - holes.mouth_radius_mm[k]) / holes.chamfer_tan)


def _inside(holes: Holes, k: NDArray[np.intp], q: Array, ray: Array) -> tuple[Array, Array, Mask]:
    """How far rays from `q` in the mouth go until they meet chamfer or wall (infinite: through), normals, on wall."""
    throat, s, radius = _throat(holes, k), holes.chamfer_tan, holes.radius_mm[k]
    w = _width(holes, k, q[:, 2])
    a = ray[:, 0] ** 2 + ray[:, 1] ** 2 - (s * ray[:, 2]) ** 2
    b = q[:, 0] * ray[:, 0] + q[:, 1] * ray[:, 1] - s * w * ray[:, 2]
    c = q[:, 0] ** 2 + q[:, 1] ** 2 - w * w
    with np.errstate(divide="ignore"):
        # From inside the cone (c < 0) there is one way out, in the form that does not cancel.
        cone = -c / (b + np.sqrt(np.maximum(b * b - a * c, 0.0)))
        on_wall = ~((cone > 0.0) & (q[:, 2] + cone * ray[:, 2] >= throat))
        to_throat = (throat - q[:, 2]) / ray[:, 2]
        x, y = (q[:, i] + to_throat * ray[:, i] for i in range(2))
        a, b = ray[:, 0] ** 2 + ray[:, 1] ** 2, x * ray[:, 0] + y * ray[:, 1]
        c = x * x + y * y - radius * radius
        wall = to_throat - c / (b + np.sqrt(np.maximum(b * b - a * c, 0.0)))
    through = on_wall & ~(q[:, 2] + wall * ray[:, 2] >= -holes.depth_mm)
    distance = np.where(on_wall, wall, cone)
    distance[through] = np.inf
    p = q[:, :2] + np.where(through, 0.0, distance)[:, None] * ray[:, :2]
    radial = p / np.maximum(np.linalg.norm(p, axis=1, keepdims=True), 1e-12)
    normal = np.column_stack([-radial, np.where(on_wall, 0.0, s)])
    return distance, normal / np.linalg.norm(normal, axis=1, keepdims=True), on_wall


def _sees_out(holes: Holes, k: NDArray[np.intp], p: Array, eye: Array) -> Mask:
    """Whether the eye sees wall points: the line must pass the throat. Chamfers are open to every eye they face."""
    share = (_throat(holes, k) - p[:, 2]) / (eye[:, 2] - p[:, 2])
    x, y = (p[:, i] + share * (eye[:, i] - p[:, i]) for i in range(2))
    return np.asarray(np.hypot(x, y) <= holes.radius_mm[k] + 1e-9)
