"""Threaded studs: flat end, lead-in and helical flanks, met in each stud's own frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.hits import HitBuffer, bar_corners, projected_box
from hal.fake.scene.shapes import PartShape, Studs, frame_on
from hal.fake.scene.thread_form import StudForm, blocked, first_hit, normals

Array = NDArray[np.float64]


def stud_hits(hits: HitBuffer, T_camera_part: Array, shape: PartShape, *, first_owner: int) -> None:
    """Add the studs of a part; stud i becomes owner `first_owner + i`."""
    studs = shape.studs
    if studs is None:
        return
    form = studs.form
    R = T_camera_part[:3, :3]
    ends = stud_ends(studs, T_camera_part)
    frames = frame_on(studs.axis) @ R.T
    pixels, k = hits.camera.windows(*projected_box(bar_corners(ends, np.full(len(ends), form.crest_radius_mm))))
    ray = np.einsum("nij,nj->ni", frames[k], hits.rays(pixels))
    origin = -np.einsum("nij,nj->ni", frames, ends[:, 0])[k]
    enter, leave, at_tip = _crest_cylinder(form, origin, ray)
    near = np.flatnonzero(enter <= leave)
    pixels, k, ray, origin = pixels[near], k[near], ray[near], origin[near]
    enter, leave, at_tip = enter[near], leave[near], at_tip[near]

    tip = origin[:, :2] + enter[:, None] * ray[:, :2]
    on_end = at_tip & (np.hypot(tip[:, 0], tip[:, 1]) <= form.tip_radius_mm)
    depth = np.where(on_end, enter, np.inf)
    side = np.flatnonzero(~on_end)
    phase = studs.phase[k]
    depth[side] = first_hit(form, origin[side], ray[side], enter[side], leave[side], phase[side])

    met = np.isfinite(depth)
    pixels, k, depth, on_end, phase = pixels[met], k[met], depth[met], on_end[met], phase[met]
    p = origin[met] + depth[:, None] * ray[met]
    normal = normals(form, p[:, 0], p[:, 1], p[:, 2], phase)
    normal[on_end] = [0.0, 0.0, 1.0]
    dark = np.zeros(len(pixels), dtype=np.bool_)
    thread = np.flatnonzero(~on_end)
    for eye in hits.camera.eyes_mm:
        towards = np.einsum("nij,nj->ni", frames, np.asarray(eye) - ends[:, 0])[k[thread]] - p[thread]
        dark[thread] |= blocked(form, p[thread], towards / towards[:, 2:], phase[thread])
    outward = np.einsum("nji,nj->ni", frames[k], normal)
    hits.keep(pixels, depth, outward, first_owner + k, dark)
    hits.occluders.append((ends, form.crest_radius_mm, first_owner))


def stud_ends(studs: Studs, T_camera_part: Array) -> Array:
    """(n, 2, 3) middle of base and of tip in the scanner frame."""
    base = np.column_stack([studs.center_mm, np.zeros(len(studs.center_mm))])
    ends = np.stack([base, base + studs.form.length_mm * studs.axis], axis=1)
    return np.asarray(ends @ T_camera_part[:3, :3].T + T_camera_part[:3, 3])


def _crest_cylinder(form: StudForm, origin: Array, ray: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Interval of the ray inside the crest cylinder between face and tip, and whether it begins at the tip."""
    a = ray[:, 0] ** 2 + ray[:, 1] ** 2
    b = origin[:, 0] * ray[:, 0] + origin[:, 1] * ray[:, 1]
    c = origin[:, 0] ** 2 + origin[:, 1] ** 2 - form.crest_radius_mm**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = (-b - root) / a, (-b + root) / a
    tip = (form.length_mm - origin[:, 2]) / ray[:, 2]
    base = -origin[:, 2] / ray[:, 2]
    first = np.where(b * b > a * c, first, np.inf)
    return np.maximum(first, tip), np.minimum(last, base), tip >= first
