"""The camera's view of the twin: true poses and shapes in, organised cloud out. Pure.

`render` gives (H, W, 3) float32 in the scanner frame, NaN where nothing was measured. Every surface is met by its
closed form (planes, cones, cylinders, spheres) or, for threads, by a root found to 1e-10 mm: there is no mesh, so no
facet lies inside the true surface. See `camera` for the instrument, `scene_*` for the surfaces, `scan_errors` for
what the instrument adds.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.camera import Camera, ScanErrors
from hal.fake.scene.clutter import clutter_hits
from hal.fake.scene.errors import measured
from hal.fake.scene.faces import face_hits
from hal.fake.scene.hits import HitBuffer
from hal.fake.scene.holes import hole_hits
from hal.fake.scene.shadows import cast_shadows
from hal.fake.scene.shapes import Clutter, PartShape
from hal.fake.scene.studs import stud_hits

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SceneState:
    """Everything that one picture needs; small enough to send to another process.

    `parts` are (T_cell_part, shape); a part that turns its back to the camera is not seen.
    """

    T_cell_camera: Array
    parts: tuple[tuple[Array, PartShape], ...] = ()
    clutter: Clutter = field(default_factory=Clutter)
    camera: Camera = field(default_factory=Camera)
    errors: ScanErrors = field(default_factory=ScanErrors)


def render(scene: SceneState, seed: int) -> NDArray[np.float32]:
    """One capture: (rows, cols, 3) float32, millimetres, NaN = not measured. Same scene and seed, same bits."""
    hits = trace(scene)
    return measured(hits, scene.errors, np.random.Generator(np.random.PCG64(seed)))


def trace(scene: SceneState) -> HitBuffer:
    """What each pixel's ray meets first, and whether both eyes see it too; without any error of the instrument."""
    hits = HitBuffer(scene.camera)
    T_camera_cell: Array = np.linalg.inv(scene.T_cell_camera).astype(np.float64)
    for number, (T_cell_part, shape) in enumerate(scene.parts):
        T_camera_part = T_camera_cell @ T_cell_part
        facing = T_camera_part[:3, 2] @ T_camera_part[:3, 3] < 0.0
        if facing and T_camera_part[2, 3] > 0.0:
            face_hits(hits, T_camera_part, shape)
            hole_hits(hits, T_camera_part, shape)
            stud_hits(hits, T_camera_part, shape, first_owner=1 + number * shape.count)
    placed = scene.clutter.moved(T_camera_cell)
    clutter_hits(hits, placed)
    cast_shadows(hits, placed)
    return hits
