"""Clouds that must be measured, and clouds that must be refused, as whole files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import pose, transform
from cellctl.vision.part import Part
from tests.vision.files import containers
from tests.vision.files.judge import Expect, File
from tests.vision.files.scenes import (
    COARSE_SERIES,
    Scene,
    drawn_angles,
    hole_part,
    hole_scene,
    hole_scenes,
    stud_part,
    stud_scene,
    stud_scenes,
)
from tests.vision.fit.reference import orientation

Array = NDArray[np.float64]
Points = NDArray[np.float32] | NDArray[np.float64]
Rng = np.random.Generator
Case = Callable[[Rng], File]
HOLES, STUDS = (1, 18), (2, 8)
"""Seed and number of the scenes that most cases share."""


def some_holes(rng: Rng) -> Scene:
    return hole_scenes(*HOLES)[int(rng.integers(HOLES[1]))]


def some_studs(rng: Rng) -> Scene:
    return stud_scenes(*STUDS)[int(rng.integers(STUDS[1]))]


def some_scene(rng: Rng) -> Scene:
    return some_holes(rng) if rng.random() < 0.7 else some_studs(rng)


def listed(rng: Rng, points: Points) -> tuple[str, bytes]:
    """A list of points (N, 3) in a container drawn at random."""
    double = bool(rng.random() < 0.3)
    choice = int(rng.integers(9))
    if choice < 3:
        layout = ("ascii", "binary_little_endian", "binary_big_endian")[choice]
        extra = str(rng.choice(["", "colours", "normals"]))
        newline = "\r\n" if layout == "ascii" and rng.random() < 0.3 else "\n"
        return ".ply", containers.ply(points, layout, double=double, extra=extra, newline=newline,
                                      faces=int(rng.choice([0, 7])))  # fmt: skip
    if choice < 6:
        layout = ("ascii", "binary", "binary_compressed")[choice - 3]
        return ".pcd", containers.pcd(points, layout, double=double, extra=bool(rng.random() < 0.3))
    if choice == 6:
        separator = str(rng.choice([" ", ",", ", ", "\t", ";"]))
        head = ([], ["# x y z"], ["// X Y Z"], [separator.join("xyz")], [str(len(points))])[int(rng.integers(5))]
        return str(rng.choice([".xyz", ".txt"])), containers.xyz(points, separator=separator, head=head)
    array = np.asfortranarray(points) if rng.random() < 0.3 else points.astype(">f4" if rng.random() < 0.3 else "<f8")
    if choice == 7:
        return ".npy", containers.npy(array)
    return ".npz", containers.npz(points=array) if rng.random() < 0.5 else containers.npz(packed=False, cloud=array)


def gridded(rng: Rng, grid: Points) -> tuple[str, bytes]:
    """A grid (H, W, 3) in a container drawn at random."""
    choice = int(rng.integers(4))
    if choice < 2:
        return ".pcd", containers.pcd(grid, str(rng.choice(["binary", "ascii"])))
    array = np.asfortranarray(grid) if rng.random() < 0.3 else grid.astype(">f4" if rng.random() < 0.3 else "<f8")
    return (".npy", containers.npy(array)) if choice == 2 else (".npz", containers.npz(packed=False, points=array))


def file_of(rng: Rng, what: str, scene: Scene, points: Points, expect: Expect, truths: tuple[Array, ...] | None = None,
            part: Part | None = None) -> File:  # fmt: skip
    """Points in a container; right is where the scene has the part unless told otherwise."""
    if points.ndim == 2:
        points = points[np.isfinite(points[:, 0])]
    suffix, data = gridded(rng, points) if points.ndim == 3 else listed(rng, points)
    return File(what, suffix, data, part or scene.part, expect, (scene.T,) if truths is None else truths)


def drawn_frame(rng: Rng, reach_mm: float = 1500.0) -> Array:
    """Any rigid motion."""
    return pose(orientation(rng), rng.uniform(-reach_mm, reach_mm, 3))


# what must be measured


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
    """A fifth of the view lost in round patches."""
    scene = some_scene(rng)
    grid = scene.grid.copy()
    rows, columns = np.indices(grid.shape[:2])
    while np.mean(np.isfinite(grid[..., 0])) > 0.8 * np.mean(np.isfinite(scene.grid[..., 0])):
        row, column = rng.uniform(0, grid.shape[0], 2)
        grid[np.hypot(rows - row, columns - column) < rng.uniform(0.01, 0.06) * grid.shape[0]] = np.nan
    return file_of(rng, "a fifth missing", scene, grid if rng.random() < 0.5 else grid.reshape(-1, 3), "pose")


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
    from tests.vision.synthetic import pose_above

    lean, about = np.radians(rng.uniform(5.0, 12.0)), rng.uniform(-np.pi, np.pi)
    return pose_above(350.0, (lean * np.cos(about), lean * np.sin(about)), rng.uniform(-np.pi, np.pi))


# what must be refused


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


def other_count(rng: Rng) -> File:
    part = hole_part(rng, "equal") if rng.random() < 0.6 else stud_part(rng, "equal")
    n = part.count
    counts = [k for k in (n - 2, n - 1, n + 1, n + 2, 2 * n, n // 2 if n % 2 == 0 else 0) if k >= 3]
    room = np.pi * part.circle_diameter_mm / (1.3 * max(part.chamfer_diameter_mm or 0.0, *(part.diameter_mm or ())))
    counts = [k for k in counts if k < room] or [n - 1]
    count = int(rng.choice(counts))
    other = replace(
        part, angles_deg=drawn_angles(rng, count, "equal"), diameter_mm=(part.diameter_mm or ())[:1] * count
    )
    return another(rng, f"{count} for {n} features", part, other)


def another(rng: Rng, what: str, part: Part, other: Part, expect: Expect = "refused") -> File:
    """A cloud of `other` for the recipe of `part`."""
    scene = hole_scene(other, rng) if other.feature == "hole" else stud_scene(other, rng)
    return file_of(rng, what, scene, scene.grid if rng.random() < 0.5 else scene.points, expect, part=part)


def factor(rng: Rng, low: float, high: float) -> float:
    """Larger or smaller by a share between `low` and `high`."""
    share = 1.0 + float(rng.uniform(low, high))
    return share if rng.random() < 0.5 else 1.0 / share


def other_circle(rng: Rng) -> File:
    part = hole_part(rng) if rng.random() < 0.6 else stud_part(rng)
    by = factor(rng, 0.03, 0.12)
    return another(rng, "another bolt circle", part, replace(part, circle_diameter_mm=part.circle_diameter_mm * by))


def other_angles(rng: Rng) -> File:
    part = hole_part(rng, "unequal") if rng.random() < 0.6 else stud_part(rng, "unequal")
    other = replace(part, angles_deg=drawn_angles(rng, part.count, str(rng.choice(["equal", "unequal"]))))
    return another(rng, "other angles", part, other)


def other_hole_size(rng: Rng) -> File:
    part = hole_part(rng, str(rng.choice(["equal", "unequal"])))
    assert part.diameter_mm is not None
    size = part.diameter_mm[0] * factor(rng, 0.07, 0.3)
    shift = size - part.diameter_mm[0]
    mouth = None if part.chamfer_diameter_mm is None else part.chamfer_diameter_mm + shift
    other = replace(part, diameter_mm=(size,) * part.count, chamfer_diameter_mm=mouth)
    return another(rng, "another hole size", part, other)


def other_thread(rng: Rng) -> File:
    part = stud_part(rng)
    thread = part.thread
    assert thread is not None
    kind = int(rng.integers(4))
    if kind == 0:
        other = replace(part, thread=replace(thread, pitch_mm=thread.pitch_mm * float(rng.choice([0.5, 0.75, 1.25]))))
    elif kind == 1:
        other = replace(part, thread=replace(thread, hand="left" if thread.hand == "right" else "right"))
    elif kind == 2:
        other = replace(part, thread=replace(thread, starts=2))
    else:
        major = float(rng.choice([size for size in COARSE_SERIES if size != thread.major_diameter_mm]))
        other = replace(part, thread=replace(thread, major_diameter_mm=major), diameter_mm=(major,) * part.count)
    return another(rng, f"another thread: {('pitch', 'hand', 'starts', 'size')[kind]}", part, other)


def other_kind(rng: Rng) -> File:
    """Studs where the recipe has holes, holes where it has studs."""
    if rng.random() < 0.5:
        scene, part = some_studs(rng), some_holes(rng).part
        return file_of(rng, "studs for holes", scene, scene.grid, "refused", part=part)
    scene, part = some_holes(rng), some_studs(rng).part
    return file_of(rng, "holes for studs", scene, scene.grid, "refused", part=part)


def mirrored(rng: Rng) -> File:
    """A left-handed scan: no rigid motion explains it where angles or threads have a hand."""
    scene = hole_scene(hole_part(rng, "unequal"), rng) if rng.random() < 0.6 else some_studs(rng)
    flip = np.ones(3)
    flip[int(rng.integers(3))] = -1.0
    points = (scene.grid if rng.random() < 0.5 else scene.points) * flip
    return file_of(rng, "mirrored", scene, points, "refused")


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


GOOD: tuple[Case, ...] = (
    plain_grid, plain_list, grid_in_another_frame, list_in_another_frame, turned_grid, cluttered, patches_missing,
    some_closed, tilted,
)  # fmt: skip
UNFIT: tuple[Case, ...] = (
    wrong_unit, not_finite, far_away, too_few, no_part, too_noisy, noisy, too_coarse, coarse, most_missing, half_cut,
    other_count, other_circle, other_angles, other_hole_size, other_thread, other_kind, mirrored, warped, two_parts,
    index_hidden, shuffled_grid,
)  # fmt: skip
