"""Clouds of the right part that cannot be measured, or maybe not: of another unit, torn, noisy, bent, doubled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellctl.vision.geometry import pose, transform
from tests.vision.files import containers
from tests.vision.files.judge import Expect, File
from tests.vision.files.packing import Case, Rng, file_of, gridded, listed, some_holes, some_scene
from tests.vision.files.scenes import Scene, hole_part, hole_scene, stud_part, stud_scene
from tests.vision.fit.reference import orientation


def wrong_unit(rng: Rng) -> File:
    name, factor = (("metres", 1e-3), ("micrometres", 1e3), ("inches", 1 / 25.4), ("centimetres", 0.1),
                    ("nanometres", 1e6))[int(rng.integers(5))]  # fmt: skip
    scene = some_scene(rng)
    points = scene.grid if rng.random() < 0.5 else scene.points
    return file_of(rng, f"in {name}", scene, points.astype(np.float64) * factor, "refused")


def not_finite(rng: Rng) -> File:
    scene = some_scene(rng)
    points = scene.points.copy() if rng.random() < 0.5 else scene.grid.copy()
    flat = points.reshape(-1, 3)
    valid = np.flatnonzero(np.isfinite(flat[:, 0]))
    chosen = rng.choice(valid, int(rng.choice([1, 20, 2000])), replace=False)
    kind = int(rng.integers(4))
    if kind == 3:
        flat[chosen, int(rng.integers(3))] = rng.choice([1e20, -1e20, 3e38])
    else:
        flat[chosen, int(rng.integers(3))] = (np.inf, -np.inf, np.nan)[kind]
    what = ("inf", "-inf", "partly nan", "huge numbers")[kind]
    suffix, data = gridded(rng, points) if points.ndim == 3 else listed(rng, points)
    return File(f"points with {what}", suffix, data, scene.part, "no pose")


def far_away(rng: Rng) -> File:
    """The whole cloud in a survey's coordinates."""
    scene = some_scene(rng)
    away = 10.0 ** rng.uniform(4.8, 7.0) * orientation(rng)[0]
    return file_of(rng, "kilometres away", scene, scene.points.astype(np.float64) + away, "refused")


def too_few(rng: Rng) -> File:
    scene = some_scene(rng)
    kind = int(rng.integers(4))
    if kind == 0:
        return file_of(rng, "a handful of points", scene, scene.points[: int(rng.integers(1, 200))], "no pose")
    if kind == 1:
        return file_of(rng, "one point over and over", scene, np.tile(scene.points[:1], (20_000, 1)), "refused")
    if kind == 2:
        few = scene.points[rng.integers(0, len(scene.points), 40)]
        return file_of(rng, "few points over and over", scene, np.tile(few, (500, 1)), "refused")
    grid = np.full_like(scene.grid, np.nan)
    return File("a grid without points", ".npy", containers.npy(grid), scene.part, "refused")


def no_part(rng: Rng) -> File:
    """Shapes without the pattern."""
    scene, n = some_scene(rng), 40_000
    kind = int(rng.integers(6))
    around = rng.uniform(-np.pi, np.pi, n)
    if kind == 0:
        points = np.column_stack([rng.uniform(-150, 150, (n, 2)), np.full(n, 350.0)])
    elif kind == 1:
        points = rng.standard_normal((n, 3))
        points = [0.0, 0.0, 350.0] + 80.0 * points / np.linalg.norm(points, axis=1, keepdims=True)
    elif kind == 2:
        points = np.column_stack([60 * np.cos(around), 60 * np.sin(around), rng.uniform(300, 420, n)])
    elif kind == 3:
        points = rng.uniform(-150.0, 150.0, (n, 3))
    elif kind == 4:
        points = np.array([0.0, 0.0, 350.0]) + np.outer(rng.uniform(-150, 150, n), orientation(rng)[0])
    else:
        rho = rng.uniform(50.0, 140.0, n)
        points = np.column_stack([rho * np.cos(around), rho * np.sin(around), np.full(n, 350.0)])
    what = ("a plane", "a ball", "a pipe", "noise", "a line", "a ring without holes")[kind]
    return file_of(rng, what, scene, points + rng.normal(0.0, 0.02, (n, 3)), "refused")


def too_noisy(rng: Rng) -> File:
    scene = some_scene(rng)
    sigma = float(rng.uniform(1.0, 3.0))
    noisy = scene.grid + rng.normal(0.0, sigma, scene.grid.shape)
    return file_of(
        rng, f"noise of {sigma:.1f} mm", scene, noisy if rng.random() < 0.5 else noisy.reshape(-1, 3), "refused"
    )


def noisy(rng: Rng) -> File:
    """Noise along the ray that may or may not be too much."""
    sigma = float(10.0 ** rng.uniform(-1.0, 0.0))
    scene = hole_scene(hole_part(rng), rng, sigma_mm=sigma) if rng.random() < 0.7 else \
        stud_scene(stud_part(rng), rng, sigma_mm=sigma)  # fmt: skip
    points = scene.grid if rng.random() < 0.5 else scene.points
    return file_of(rng, "noise of a tenth to one mm", scene, points, "honest")


def too_coarse(rng: Rng) -> File:
    scene = some_scene(rng)
    step = int(np.ceil(0.55 * min(scene.part.diameter_mm or ()) / spacing_of(scene)))
    grid = scene.grid[::step, ::step]
    return file_of(rng, "too coarse", scene, grid if rng.random() < 0.5 else grid.reshape(-1, 3), "refused")


def coarse(rng: Rng) -> File:
    scene = some_scene(rng)
    step = max(2, int(rng.uniform(0.08, 0.5) * min(scene.part.diameter_mm or ()) / spacing_of(scene)))
    grid = scene.grid[::step, ::step]
    return file_of(rng, "coarse", scene, grid if rng.random() < 0.5 else grid.reshape(-1, 3), "honest")


def spacing_of(scene: Scene) -> float:
    """Distance of neighbouring pixels on the face, mm."""
    steps = np.linalg.norm(np.diff(scene.grid[scene.grid.shape[0] // 2], axis=0), axis=1)
    return float(np.nanmedian(steps))


def most_missing(rng: Rng) -> File:
    """More than half of the features are not there, or lie in the part of the view that is lost."""
    if rng.random() < 0.5:
        holes = rng.random() < 0.6
        part = hole_part(rng) if holes else stud_part(rng)
        closed = tuple(map(int, rng.permutation(part.count)[: part.count // 2 + 1 + int(rng.integers(0, 2))]))
        scene = (hole_scene if holes else stud_scene)(part, rng, missing=closed)
        return file_of(rng, "most features not there", scene, scene.grid, "refused")
    scene = some_scene(rng)
    local = transform(np.linalg.inv(scene.T), scene.points)
    share = rng.uniform(0.6, 0.8)
    about = np.arctan2(local[:, 1], local[:, 0]) + rng.uniform(-np.pi, np.pi)
    kept = scene.points[np.mod(about, 2 * np.pi) > 2 * np.pi * share]
    return file_of(rng, "most of the face lost", scene, kept, "refused")


def half_cut(rng: Rng) -> File:
    scene = some_scene(rng)
    local = transform(np.linalg.inv(scene.T), scene.points)
    turn = rng.uniform(-np.pi, np.pi)
    kept = scene.points[local[:, 0] * np.cos(turn) + local[:, 1] * np.sin(turn) > rng.normal(0.0, 3.0)]
    return file_of(rng, "half cut away", scene, kept, "honest")


def warped(rng: Rng) -> File:
    """Bent far beyond the flatness of the recipe, or a step across the face."""
    scene = some_holes(rng)
    local = transform(np.linalg.inv(scene.T), scene.grid)
    rim = 0.5 * (scene.part.face_outer_diameter_mm or 0.0)
    turn = rng.uniform(-np.pi, np.pi)
    u, v = local[..., 0] * np.cos(turn) + local[..., 1] * np.sin(turn), local[..., 1]
    kind = int(rng.integers(4))
    size = float(rng.uniform(0.5, 3.0))
    shape = (u**2, u * v, np.where(u > 0.0, rim**2, 0.0), np.maximum(u, 0.0) * rim)[kind] / rim**2
    bent = transform(scene.T, local + shape[..., None] * [0.0, 0.0, size])
    what = ("bent", "twisted", "with a step", "with a kink")[kind]
    # a step makes two faces of one, and half of the features on either may be enough
    expect: Expect = "honest" if kind == 2 else "refused"
    upper = scene.T @ pose(np.eye(3), np.array([0.0, 0.0, size]))
    points = bent if rng.random() < 0.5 else bent.reshape(-1, 3)
    return file_of(rng, f"a face {what}", scene, points, expect, (scene.T, upper))


def two_parts(rng: Rng) -> File:
    """The same part twice: nothing says which one is meant."""
    scene = some_scene(rng)
    aside = np.eye(4)
    aside[:3, 3] = scene.T[:3, :3] @ [1.15 * (scene.part.face_outer_diameter_mm or 0.0), 0.0, 0.0]
    both = np.concatenate([scene.points, transform(aside, scene.points)])
    return file_of(rng, "two parts in view", scene, rng.permutation(both), "refused", (scene.T, aside @ scene.T))


def index_hidden(rng: Rng) -> File:
    """The one feature that tells the clocking, and another one, lie in the part of the view that is lost."""
    part = replace(hole_part(rng, "index"), chamfer_diameter_mm=None, chamfer_angle_deg=None)
    scene = hole_scene(part, rng)
    local = transform(np.linalg.inv(scene.T), scene.points)
    keep = np.ones(len(local), dtype=np.bool_)
    for feature in (0, int(rng.integers(1, part.count))):
        angle = np.radians(part.angles_deg[feature])
        place = 0.5 * part.circle_diameter_mm * np.array([np.cos(angle), np.sin(angle)])
        keep &= np.hypot(*(local[:, :2] - place).T) > 0.9 * max(part.diameter_mm or ())
    return file_of(rng, "index hidden", scene, scene.points[keep], "refused")


def shuffled_grid(rng: Rng) -> File:
    scene = some_scene(rng)
    kind = int(rng.integers(3))
    if kind == 0:
        grid = rng.permutation(scene.grid, axis=0)
    elif kind == 1:
        grid = rng.permutation(scene.grid.reshape(-1, 3)).reshape(scene.grid.shape)
    else:
        width = int(rng.integers(2, scene.grid.shape[1]))
        grid = scene.grid.reshape(-1, 3)[: scene.grid[..., 0].size // width * width].reshape(-1, width, 3)
    what = ("rows shuffled", "pixels shuffled", "another width")[kind]
    return file_of(rng, f"grid with {what}", scene, grid, "honest")


POOR: tuple[Case, ...] = (
    wrong_unit, not_finite, far_away, too_few, no_part, too_noisy, noisy, too_coarse, coarse, most_missing, half_cut,
    warped, two_parts, index_hidden, shuffled_grid,
)  # fmt: skip
