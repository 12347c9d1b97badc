"""Random joints and what a camera sees of them: the true pose beside every cloud, the recipe as text."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Part, Thread
from hal.fake.scene.camera import ScanErrors, camera_for
from hal.fake.scene.render import SceneState
from hal.fake.scene.render import render as capture
from hal.fake.scene.shapes import PartShape, Studs
from hal.fake.scene.thread_form import StudForm
from tests.vision.synthetic import View, pose_above, render

Array = NDArray[np.float64]
COARSE_SERIES = {5.0: 0.8, 6.0: 1.0, 8.0: 1.25, 10.0: 1.5, 12.0: 1.75}
"""ISO 261: pitch of the coarse thread by major diameter, mm."""


@dataclass(frozen=True)
class Scene:
    """A part as the recipe has it, the grid (H, W, 3) that shows it and where it truly is."""

    part: Part
    grid: NDArray[np.float32]
    T: Array

    @property
    def points(self) -> NDArray[np.float32]:
        """The valid points (N, 3) alone."""
        return self.grid[np.isfinite(self.grid[..., 0])]

    @property
    def side(self) -> str:
        """Which side of the joint the part is measured as."""
        return "shaft" if self.part.feature == "hole" else "rotor"


def recipe_text(part: Part) -> str:
    """A recipe that only measures: `[recipe]`, `[pattern]` and the part."""
    lines = ['[recipe]\nid = "drawn"\nversion = 1\ntitle = "drawn at random"\n\n[pattern]']
    lines += [f"count = {part.count}", f"circle_diameter_mm = {part.circle_diameter_mm!r}"]
    lines.append(f"angles_deg = {list(part.angles_deg)}")
    if part.index_feature is not None:
        lines.append(f"index_feature = {part.index_feature}")
    lines.append(f'\n[{"shaft" if part.feature == "hole" else "rotor"}]\nfeature = "{part.feature}"')
    if part.diameter_mm is not None:
        lines.append(f"diameter_mm = {list(part.diameter_mm)}")
    for name in ("chamfer_diameter_mm", "chamfer_angle_deg", "depth_mm", "length_mm", "face_inner_diameter_mm",
                 "face_outer_diameter_mm", "ledge_step_mm", "flatness_limit_mm"):  # fmt: skip
        value = getattr(part, name)
        if value is not None:
            lines.append(f"{name} = {value!r}")
    if part.thread is not None:
        lines.append(f"thread = {{ major_diameter_mm = {part.thread.major_diameter_mm!r}, "
                     f'pitch_mm = {part.thread.pitch_mm!r}, hand = "{part.thread.hand}", '
                     f"starts = {part.thread.starts} }}")  # fmt: skip
    return "\n".join(lines) + "\n"


def drawn_angles(rng: np.random.Generator, count: int, kind: str) -> tuple[float, ...]:
    """Angles of a pattern: "equal", or "unequal" by up to a fifth of the pitch."""
    angles = 360.0 * np.arange(count) / count
    if kind == "unequal":
        angles = angles + rng.uniform(-0.2, 0.2, count) * 360.0 / count
    return tuple(float(angle) for angle in angles - angles[0])


def hole_part(rng: np.random.Generator, kind: str | None = None) -> Part:
    """A drilled face. `kind`: "equal", "unequal", or "index" (one hole larger by a quarter)."""
    kind = kind or str(rng.choice(["equal", "unequal", "index"]))
    count = int(rng.integers(4, 31))
    circle = float(rng.uniform(80.0, 260.0))
    angles = drawn_angles(rng, count, kind)
    bridge = np.pi * circle * float(np.diff([*angles, 360.0]).min()) / 360.0
    if bridge < 9.0:  # holes of five millimetres with their chamfers would run into each other
        return hole_part(rng, kind)
    size = float(np.clip(rng.uniform(0.3, 0.55) * bridge, 5.0, 0.1 * circle))
    sizes = np.full(count, size)
    if kind == "index":
        sizes[0] *= 1.25
    mouth: float | None = float(sizes.max()) + min(float(rng.uniform(0.8, 2.0)), 0.35 * (bridge - float(sizes.max())))
    if kind == "index" and rng.random() < 0.5:
        mouth = None
    widest = mouth or float(sizes.max())
    inner, outer = circle - 2.0 * widest - 4.0, circle + 2.0 * widest + 4.0
    return Part(
        feature="hole", circle_diameter_mm=circle, angles_deg=angles,
        index_feature=None if kind == "equal" else 0, diameter_mm=tuple(map(float, sizes)), chamfer_diameter_mm=mouth,
        chamfer_angle_deg=float(rng.uniform(30.0, 50.0)) if mouth else None,
        depth_mm=float(rng.uniform(1.4, 2.5) * size), face_inner_diameter_mm=inner, face_outer_diameter_mm=outer,
        ledge_step_mm=float(rng.uniform(2.0, 6.0)), flatness_limit_mm=0.05,
    )  # fmt: skip


def stud_part(rng: np.random.Generator, kind: str | None = None) -> Part:
    """A face with threaded studs of the coarse series."""
    kind = kind or str(rng.choice(["equal", "unequal"]))
    major = float(rng.choice(list(COARSE_SERIES)))
    count = int(rng.integers(5, 19))
    angles = drawn_angles(rng, count, kind)
    circle = max(float(rng.uniform(90.0, 200.0)), 2.0 * major * 360.0 / np.pi / float(np.diff([*angles, 360.0]).min()))
    return Part(
        feature="stud", circle_diameter_mm=circle, angles_deg=angles,
        diameter_mm=(major,) * count, length_mm=float(rng.uniform(2.8, 4.0) * major),
        thread=Thread(major, COARSE_SERIES[major], "left" if rng.random() < 0.2 else "right"),
        face_inner_diameter_mm=circle - 4.0 * major, face_outer_diameter_mm=circle + 4.0 * major, ledge_step_mm=5.0,
        flatness_limit_mm=0.05,
    )  # fmt: skip


def drawn_pose(rng: np.random.Generator, tilt_rad: float = 0.05) -> Array:
    """The part before the camera, turned at random and tilted a little."""
    return pose_above(rng.uniform(335.0, 365.0), tuple(rng.normal(0.0, tilt_rad / 2.0, 2)),
                      rng.uniform(-np.pi, np.pi), tuple(rng.normal(0.0, 3.0, 2)))  # fmt: skip


def hole_scene(part: Part, rng: np.random.Generator, pixels: int = 300, T: Array | None = None, **values: Any) -> Scene:
    """The part seen with `pixels` in a row and white noise; `values` go to `synthetic.View`."""
    outer = part.face_outer_diameter_mm or 1.3 * part.circle_diameter_mm
    pose = drawn_pose(rng) if T is None else T
    view = View(part, pose, pixels=pixels, field_mm=1.2 * outer, offsets_mm=rng.normal(0.0, 0.01, (part.count, 2)))
    return Scene(part, render(replace(view, **values), rng), pose)


def stud_scene(part: Part, rng: np.random.Generator, pixels: int = 420, T: Array | None = None, sigma_mm: float = 0.03,
               missing: tuple[int, ...] = ()) -> Scene:  # fmt: skip
    """The part seen by the twin's camera, with white noise and nothing else wrong."""
    pose = drawn_pose(rng, 0.02) if T is None else T
    assert part.thread is not None and part.length_mm is not None
    there = [i for i in range(part.count) if i not in missing]
    angles = np.radians(part.angles_deg)[there]
    centres = 0.5 * part.circle_diameter_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    axes = np.tile([0.0, 0.0, 1.0], (len(there), 1))
    thread = part.thread
    form = StudForm(0.5 * thread.major_diameter_mm - 0.015, thread.pitch_mm, thread.starts,
                    1 if thread.hand == "right" else -1, part.length_mm)  # fmt: skip
    studs = Studs(centres + rng.normal(0.0, 0.01, centres.shape), axes, rng.random(len(there)), form)
    inner, outer = 0.5 * (part.face_inner_diameter_mm or 0.0), 0.5 * (part.face_outer_diameter_mm or 0.0)
    shape = PartShape(((inner, outer, 0.0), (outer, outer + 12.0, -(part.ledge_step_mm or 5.0))), studs=studs)
    camera = replace(camera_for(pixels * pixels), half_width=1.2 * outer / float(pose[2, 3]), near_mm=200.0)
    errors = ScanErrors(sigma_mm, correlation_px=0.0, ripple_mm=0.0, scale=0.0, bands=0)
    scene = SceneState(np.eye(4), ((pose, shape),), camera=camera, errors=errors)
    return Scene(part, capture(scene, int(rng.integers(2**31))), pose)


@cache
def hole_scenes(seed: int, count: int) -> tuple[Scene, ...]:
    """Scenes to damage: drawn once, because drawing costs more than measuring."""
    rng = np.random.default_rng(seed)
    kinds = ("equal", "unequal", "index")
    return tuple(hole_scene(hole_part(rng, kinds[i % 3]), rng, int(rng.integers(220, 400))) for i in range(count))


@cache
def stud_scenes(seed: int, count: int) -> tuple[Scene, ...]:
    """The same with studs."""
    rng = np.random.default_rng(seed)
    return tuple(stud_scene(stud_part(rng, ("equal", "unequal")[i % 2]), rng) for i in range(count))
