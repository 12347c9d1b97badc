"""The nearest hit of each pixel's ray, with normal, owner and whether an eye misses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.camera import Camera

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

FLAT = 0
"""Owner of rings: plane, open, seen at a moderate angle."""
ROUND = -1
"""Owner of every other surface that is no stud; studs own themselves, from 1."""


class HitBuffer:
    """One image, pixels flat row by row. `depth` is z in the scanner frame, infinite where nothing was met.

    `normal` (N, 3) points out of the material; `dark` is true where an eye is known to be blind.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.u, self.v = camera.slopes()
        count = self.u.size
        self.depth: Array = np.full(count, np.inf)
        self.normal: NDArray[np.float32] = np.zeros((count, 3), dtype=np.float32)
        self.owner: NDArray[np.int16] = np.zeros(count, dtype=np.int16)
        self.dark: Mask = np.zeros(count, dtype=np.bool_)
        self.occluders: list[tuple[Array, float, int]] = []
        """Studs by ends (n, 2, 3), radius and owner of the first."""

    def rays(self, pixels: Indices) -> Array:
        """(n, 3) rays (u, v, 1)."""
        return np.stack([self.u[pixels], self.v[pixels], np.ones(pixels.size)], axis=1)

    def points(self, pixels: Indices) -> Array:
        """(n, 3) points met, scanner frame."""
        return self.rays(pixels) * self.depth[pixels, None]

    def keep(self, pixels: Indices, depth: Array, normal: Array, owner: int | Indices, dark: Mask | bool) -> None:
        """Take hits that lie nearer than what is there; of several for one pixel the nearest wins."""
        near = np.flatnonzero((depth < self.depth[pixels]) & (depth > 0.0))
        near = near[np.argsort(-depth[near], kind="stable")]
        at = pixels[near]
        self.depth[at] = depth[near]
        self.normal[at] = normal[near] if normal.ndim == 2 else normal
        self.owner[at] = owner if isinstance(owner, int) else owner[near]
        self.dark[at] = dark if isinstance(dark, bool) else dark[near]


def dot(a: Array, b: Array) -> Array:
    """(n,) of the products of rows (n, 3)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def projected_box(corners: Array) -> tuple[Array, Array]:
    """Slopes (n, 2) low and high of the boxes spanned by `corners` (n, m, 3), all in front of the camera."""
    slopes = corners[..., :2] / corners[..., 2:]
    return slopes.min(axis=1), slopes.max(axis=1)


def bar_corners(ends: Array, radius: Array) -> Array:
    """(n, 16, 3) corners of boxes around bars with `ends` (n, 2, 3)."""
    signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    corners = ends[:, :, None, :] + radius[:, None, None, None] * signs
    return np.asarray(corners.reshape(len(ends), 16, 3))
