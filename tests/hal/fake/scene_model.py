"""An independent statement of the scene's solids, for tests: where a point is inside, and how far off a surface.

Written from the drawing (ISO 68-1 profile, cones, cylinders, planes) and sharing no code with the renderer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.artefacts import BenchFurniture
from hal.fake.scene.camera import IDEAL, ScanErrors, camera_for
from hal.fake.scene.render import SceneState
from hal.fake.scene.shapes import Clutter, Holes, PartShape, Studs
from hal.fake.scene.thread_form import StudForm

Array = NDArray[np.float64]

COUNT = 36
UP = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 50], [0, 0, 0, 1]])
DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 350], [0, 0, 0, 1]])


def pattern(sign: float, rng: np.random.Generator) -> Array:
    angle = sign * 2.0 * np.pi * np.arange(COUNT) / COUNT
    return 120.0 * np.column_stack([np.cos(angle), np.sin(angle)]) + rng.normal(0.0, 0.02, (COUNT, 2))


def axes(rng: np.random.Generator, tilt_deg: float = 0.1) -> Array:
    axis = np.column_stack([rng.normal(0.0, np.radians(tilt_deg), (COUNT, 2)), np.ones(COUNT)])
    return np.asarray(axis / np.linalg.norm(axis, axis=1, keepdims=True))


def shaft_shape(seed: int = 1) -> PartShape:
    rng = np.random.default_rng(seed)
    radius = 4.15 + rng.normal(0.0, 0.01, COUNT)
    return PartShape(
        rings_mm=((90.5, 140.0, 0.0), (140.0, 150.0, -5.0)),
        bevels_mm=((90.0, -0.5, 90.5, 0.0),),
        bore_mm=(90.0, -0.5, -60.0),
        holes=Holes(pattern(1.0, rng), axes(rng), radius, radius + 0.8, 1.0, 14.0),
    )


def rotor_shape(seed: int = 2, form: StudForm | None = None) -> PartShape:
    rng = np.random.default_rng(seed)
    return PartShape(
        rings_mm=((70.0, 89.5, 3.0), (90.0, 140.0, 0.0), (140.0, 150.0, -5.0)),
        bevels_mm=((89.5, 3.0, 90.0, 2.5),),
        bore_mm=(70.0, 3.0, -60.0),
        studs=Studs(pattern(-1.0, rng), axes(rng), rng.random(COUNT), form or StudForm()),
    )


def scene(
    view: str, points: int = 120_000, errors: ScanErrors = IDEAL, form: StudForm | None = None, seed: int = 1
) -> SceneState:
    """Both parts a little off and tilted, everything that stands on the bench."""
    T_shaft = moved(np.eye(4), [1.7, -2.3, 0.4], [0.2, -0.15, 12.3])
    T_rotor = moved(np.diag([1.0, -1.0, -1.0, 1.0]), [0.3, -0.2, 400.1], [-0.1, 0.12, 3.1])
    return SceneState(
        T_cell_camera=UP if view == "rotor" else DOWN,
        parts=((T_shaft, shaft_shape(seed)), (T_rotor, rotor_shape(seed + 1, form))),
        clutter=BenchFurniture().clutter(),
        camera=camera_for(points),
        errors=errors,
    )


def moved(pose: Array, shift: list[float], angles_deg: list[float]) -> Array:
    a, b, c = np.radians(angles_deg)
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3] = rz @ ry @ rx @ pose[:3, :3]
    out[:3, 3] = shift
    return out


def into(T: Array, points: Array) -> Array:
    """Points of the outer frame in the frame that T carries out."""
    return np.asarray((points - T[:3, 3]) @ T[:3, :3])


def feature_coordinates(center: Array, axis: Array, points: Array) -> tuple[Array, Array, Array]:
    """Nearest feature of each point, height along its axis, and (n, 2) across in the feature's frame (x from x)."""
    k = np.argmin(np.linalg.norm(points[:, None, :2] - center[None], axis=2), axis=1)
    offset = points - np.column_stack([center[k], np.zeros(len(k))])
    x = np.array([1.0, 0.0, 0.0]) - axis[:, :1] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(axis, x)
    return (
        k,
        np.sum(offset * axis[k], axis=1),
        np.column_stack([np.sum(offset * x[k], axis=1), np.sum(offset * y[k], axis=1)]),
    )


def thread_radius(form: StudForm, z: Array, across: Array, phase: Array) -> tuple[Array, Array]:
    """Radius of the stud and a class: 0 crest, 1 flank, 2 root, 3 lead-in."""
    P, d = form.pitch_mm, 2.0 * form.crest_radius_mm
    phi = np.arctan2(across[:, 1], across[:, 0])
    place = np.mod(z / P - form.hand * form.starts * phi / (2.0 * np.pi) - phase, 1.0)
    off = P * np.minimum(place, 1.0 - place)
    # Pitch diameter d2 = d - 0.649519 P; there flank and gap are each P/2 wide (ISO 68-1).
    flank = (d - 0.649519053 * P) / 2.0 - (off - P / 4.0) / np.tan(np.radians(30.0))
    root = (d - 1.22687 * P) / 2.0
    radius = np.clip(flank, root, d / 2.0)
    kind = np.where(flank > d / 2.0, 0, np.where(flank < root, 2, 1))
    lead = root + (form.length_mm - z) * form.lead_in_tan
    return np.minimum(radius, lead), np.where(lead < radius, 3, kind)


def deviations(part: PartShape, points: Array) -> dict[str, Array]:
    """Distance of points (part frame) to each kind of surface of the part; infinite outside that surface's extent."""
    r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    slack, far = 0.01, np.full(len(points), np.inf)
    out: dict[str, Array] = {}
    for name, ring in zip(("ring0", "ring1", "ring2"), part.rings_mm, strict=False):
        out[name] = np.where((r > ring[0] - slack) & (r < ring[1] + slack), np.abs(z - ring[2]), far)
    for r0, z0, r1, z1 in part.bevels_mm:
        line = np.abs((r - r0) * (z1 - z0) - (z - z0) * (r1 - r0)) / np.hypot(r1 - r0, z1 - z0)
        out["bevel"] = np.where((z > min(z0, z1) - slack) & (z < max(z0, z1) + slack), line, far)
    if part.bore_mm is not None:
        out["bore"] = np.where(z < part.bore_mm[1] + slack, np.abs(r - part.bore_mm[0]), far)
    if part.holes is not None:
        h = part.holes
        k, along, across = feature_coordinates(h.center_mm, h.axis, points)
        rho = np.hypot(across[:, 0], across[:, 1])
        half = np.arctan(h.chamfer_tan)
        edge = -(h.mouth_radius_mm[k] - h.radius_mm[k]) / h.chamfer_tan
        cone = np.abs((rho - h.mouth_radius_mm[k]) * np.cos(half) - along * np.sin(half))
        out["chamfer"] = np.where((along > edge - slack) & (along < 0.1), cone, far)
        out["wall"] = np.where(
            (along < edge + slack) & (along > -h.depth_mm - slack), np.abs(rho - h.radius_mm[k]), far
        )
    if part.studs is not None:
        s = part.studs
        k, along, across = feature_coordinates(s.center_mm, s.axis, points)
        rho = np.hypot(across[:, 0], across[:, 1])
        radius, kind = thread_radius(s.form, along, across, s.phase[k])
        gap = np.abs(rho - radius)
        on = (along > -slack) & (along < s.form.length_mm + slack)
        for number, (name, lean) in enumerate((("crest", 1.0), ("flank", 0.5), ("root", 1.0), ("lead_in", 2.0**-0.5))):
            out[name] = np.where(on & (kind == number), gap * lean, far)
        out["tip"] = np.where(rho < s.form.tip_radius_mm + slack, np.abs(along - s.form.length_mm), far)
    return out


def clutter_deviations(clutter: Clutter, points: Array) -> dict[str, Array]:
    """Distance of points (cell frame) to spheres and bars."""
    to_center = np.linalg.norm(points[:, None] - clutter.spheres_mm[None], axis=2)
    best = np.full(len(points), np.inf)
    for ends, radius in zip(clutter.bars_mm, clutter.bar_radius_mm, strict=True):
        length = float(np.linalg.norm(ends[1] - ends[0]))
        axis = (ends[1] - ends[0]) / length
        along = (points - ends[0]) @ axis
        rho = np.linalg.norm(points - ends[0] - along[:, None] * axis, axis=1)
        side = np.where((along > -1e-6) & (along < length + 1e-6), np.abs(rho - radius), np.inf)
        cap = np.where(rho < radius + 1e-6, np.minimum(np.abs(along), np.abs(along - length)), np.inf)
        best = np.minimum(best, np.minimum(side, cap))
    return {"sphere": np.abs(to_center - clutter.sphere_radius_mm).min(axis=1), "bar": best}


def all_deviations(state: SceneState, view: str, points: Array) -> tuple[Array, NDArray[np.str_]]:
    """Distance of scanner points (n, 3) to the nearest surface, and that surface's name."""
    cell = points @ state.T_cell_camera[:3, :3].T + state.T_cell_camera[:3, 3]
    T, part = state.parts[0 if view == "shaft" else 1]
    found = deviations(part, into(T, cell)) | clutter_deviations(state.clutter, cell)
    table = np.array(list(found.values()))
    return table.min(axis=0), np.array(list(found))[table.argmin(axis=0)]


def inside(part: PartShape, points: Array, tiny: float) -> NDArray[np.bool_]:
    """Whether points (part frame) lie in the part's material by more than `tiny`."""
    r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    solid = np.zeros(len(points), dtype=np.bool_)
    for inner, outer, top in part.rings_mm:
        solid |= (r > inner + tiny) & (r < outer - tiny) & (z < top - tiny) & (z > -14.0)
    for r0, z0, r1, z1 in part.bevels_mm:
        # Material lies below the line from (r0, z0) to (r1, z1).
        solid |= (r > r0 + tiny) & (r < r1 - tiny) & (z < z0 + (r - r0) * (z1 - z0) / (r1 - r0) - tiny) & (z > -14.0)
    if part.holes is not None:
        h = part.holes
        k, along, across = feature_coordinates(h.center_mm, h.axis, points)
        rho = np.hypot(across[:, 0], across[:, 1])
        width = np.maximum(h.radius_mm[k], h.mouth_radius_mm[k] + along * h.chamfer_tan)
        solid &= rho > width + tiny
    if part.studs is not None:
        s = part.studs
        k, along, across = feature_coordinates(s.center_mm, s.axis, points)
        radius, _ = thread_radius(s.form, along, across, s.phase[k])
        solid |= (np.hypot(across[:, 0], across[:, 1]) < radius - tiny) & (along > 0.0) & (along < s.form.length_mm)
    return solid
