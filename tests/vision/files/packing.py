"""Scenes drawn at random, packed into files of a kind drawn at random."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import pose
from cellctl.vision.part import Part
from tests.vision.files import containers
from tests.vision.files.judge import Expect, File
from tests.vision.files.scenes import Scene, hole_scenes, stud_scenes
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
