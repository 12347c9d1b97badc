"""Clouds that must be measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellctl.vision.geometry import transform
from cellctl.vision.pattern import blind_to_sizes
from tests.vision.files.judge import File
from tests.vision.files.packing import Array, Case, Rng, drawn_frame, file_of, some_scene
from tests.vision.files.scenes import hole_part, hole_scene, stud_part, stud_scene
from tests.vision.synthetic import pose_above


def plain_grid(rng: Rng) -> File:
    scene = some_scene(rng)
    return file_of(rng, "grid", scene, scene.grid, "pose")


def plain_list(rng: Rng) -> File:
    scene = some_scene(rng)
    return file_of(rng, "list", scene, rng.permutation(scene.points), "pose")


def grid_in_another_frame(rng: Rng) -> File:
    scene, T = some_scene(rng), drawn_frame(rng)
    return file_of(rng, "grid in another frame", scene, transform(T, scene.grid), "pose", (T @ scene.T,))


def list_in_another_frame(rng: Rng) -> File:
    scene, T = some_scene(rng), drawn_frame(rng)
    return file_of(rng, "list in another frame", scene, transform(T, scene.points), "pose", (T @ scene.T,))


def turned_grid(rng: Rng) -> File:
    scene = some_scene(rng)
    grid = np.rot90(scene.grid, int(rng.integers(4)))
    grid = grid.transpose(1, 0, 2) if rng.random() < 0.5 else grid[:, ::-1]
    return file_of(rng, "grid turned or transposed", scene, np.ascontiguousarray(grid), "pose")


def cluttered(rng: Rng) -> File:
    """A table far larger than the part, a wall and a ball in view."""
    scene = some_scene(rng)
    floor = np.column_stack([rng.uniform(-400, 400, (60_000, 2)), np.full(60_000, 480.0)])
    wall = np.column_stack([np.full(20_000, 300.0), rng.uniform(-300, 300, 20_000), rng.uniform(250, 480, 20_000)])
    ball = rng.standard_normal((5_000, 3))
    ball = [-260.0, 0.0, 430.0] + 40.0 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    strays = np.concatenate([floor, wall, ball]) + rng.normal(0.0, 0.03, (85_000, 3))
    strays = strays[np.hypot(strays[:, 0] - scene.T[0, 3], strays[:, 1] - scene.T[1, 3]) > 180.0]
    everything = rng.permutation(np.concatenate([scene.points, strays.astype(np.float32)]))
    if rng.random() < 0.5:
        return file_of(rng, "clutter", scene, everything, "pose")
    T = drawn_frame(rng)
    return file_of(rng, "clutter in another frame", scene, transform(T, everything), "pose", (T @ scene.T,))


def patches_missing(rng: Rng) -> File:
    """A fifth of the view lost in round patches: of few holes too many may be torn, or the one that is number 0."""
    scene = some_scene(rng)
    grid = scene.grid.copy()
    rows, columns = np.indices(grid.shape[:2])
    while np.mean(np.isfinite(grid[..., 0])) > 0.8 * np.mean(np.isfinite(scene.grid[..., 0])):
        row, column = rng.uniform(0, grid.shape[0], 2)
        grid[np.hypot(rows - row, columns - column) < rng.uniform(0.01, 0.06) * grid.shape[0]] = np.nan
    safe = scene.part.count > 5 and blind_to_sizes(scene.part) is scene.part
    points = grid if rng.random() < 0.5 else grid.reshape(-1, 3)
    return file_of(rng, "a fifth missing", scene, points, "pose" if safe else "honest")


def some_closed(rng: Rng) -> File:
    """Up to a fifth of the features are not there: reported, none invented."""
    holes = rng.random() < 0.6
    part = hole_part(rng, "unequal") if holes else stud_part(rng, "unequal")
    number = int(rng.integers(1, max(2, part.count // 5 + 1)))
    closed = tuple(map(int, rng.permutation(part.count)[: min(number, part.count - 4)]))
    make = hole_scene if holes else stud_scene
    scene = make(part, rng, missing=closed)
    angles = np.radians(part.angles_deg)[list(closed)]
    ring = 0.5 * part.circle_diameter_mm
    places = np.column_stack([ring * np.cos(angles), ring * np.sin(angles), np.zeros(len(closed))])
    file = file_of(rng, "features not there", scene, scene.grid, "pose" if part.count > 5 else "honest")
    return replace(file, closed_mm=transform(scene.T, places))


def tilted(rng: Rng) -> File:
    part = hole_part(rng)
    T = pose_tilted(rng)
    scene = hole_scene(part, rng, T=T)
    return file_of(rng, "tilted", scene, scene.grid if rng.random() < 0.5 else scene.points, "pose")


def pose_tilted(rng: Rng) -> Array:
    """Before the camera, leaning by 5 to 12 degrees."""
    lean, about = np.radians(rng.uniform(5.0, 12.0)), rng.uniform(-np.pi, np.pi)
    return pose_above(350.0, (lean * np.cos(about), lean * np.sin(about)), rng.uniform(-np.pi, np.pi))


GOOD: tuple[Case, ...] = (
    plain_grid, plain_list, grid_in_another_frame, list_in_another_frame, turned_grid, cluttered, patches_missing,
    some_closed, tilted,
)  # fmt: skip
