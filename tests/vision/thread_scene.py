"""Exact clouds of threaded studs, by marching every ray until it is inside; independent of the fit and of the twin.

Stud frame: s from the face to the tip. Scanner frame: pinhole at the origin, z away from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bolt:
    """True sizes, millimetres; hand +1 right, -1 left.

    Profile of ISO 68-1 unless `crest` (share of the pitch that is flat), `round_mm` (how far the crest's corners are
    rounded) or `depth` (in pitches) say otherwise. The lead-in falls by `fall` per mm, down to the root at the tip;
    `lead_in` moves it along the stud, and far enough away leaves a flat end at full size. `dome_mm` is the radius of a
    round end, 0 for a flat one. Below `shank` the stud is plain.
    """

    radius: float = 3.9863
    pitch: float = 1.0037
    hand: int = 1
    starts: int = 1
    length: float = 32.0
    phase: float = 0.3
    depth: float = 0.613
    crest: float = 0.125
    round_mm: float = 0.0
    fall: float = 1.0
    lead_in: float = 0.0
    dome_mm: float = 0.0
    shank: float = -1.0

    def height(self, p: Array) -> Array:
        """Positive outside, along the radius."""
        x, y, s = p.T
        turns = (s - self.phase) / self.pitch - self.hand * self.starts * np.arctan2(y, x) / (2 * np.pi)
        deep = ((np.abs(turns - np.round(turns)) - 0.5 * self.crest) * self.pitch) * np.sqrt(3)
        if self.round_mm:
            deep = np.where(np.abs(deep) < self.round_mm, (deep + self.round_mm) ** 2 / (4 * self.round_mm), deep)
        thread = np.where(s < self.shank, self.radius, self.radius - np.clip(deep, 0, self.depth * self.pitch))
        end = self.radius - self.depth * self.pitch + self.fall * (self.length - s + self.lead_in)
        if self.dome_mm:
            above = np.maximum(s - (self.length - self.dome_mm), 0.0)
            end = np.minimum(end, np.sqrt(np.maximum(self.dome_mm**2 - above**2, 0.0)))
        return np.hypot(x, y) - np.minimum(thread, end)


def hit(bolt: Bolt, eye: Array, rays: Array, step: float = 0.04) -> Array:
    """Distance along unit rays (n, 3) from `eye` to the stud, infinite where missed: marching, then bisection.

    The march runs inside the crest cylinder between face and tip, in steps a third of a crest's width.
    """
    found = np.full(len(rays), np.inf)
    a, b = np.sum(rays[:, :2] ** 2, axis=1), rays[:, :2] @ eye[:2]
    square = b**2 - a * (eye[:2] @ eye[:2] - bolt.radius**2)
    root = np.sqrt(np.maximum(square, 0.0))
    heights = np.sort(np.stack([(bolt.length - eye[2]) / rays[:, 2], -eye[2] / rays[:, 2]]), axis=0)
    start, end = np.maximum((-b - root) / a, heights[0]), np.minimum((-b + root) / a, heights[1])
    alive = np.flatnonzero((square > 0) & (end > start))
    at = start + 1e-9

    def inside(rows: NDArray[np.intp], where: Array) -> NDArray[np.bool_]:
        return bolt.height(eye + where[:, None] * rays[rows]) <= 0

    first = inside(alive, at[alive])
    found[alive[first]] = at[alive[first]]
    alive = alive[~first]
    while len(alive):
        at[alive] += step
        met = inside(alive, at[alive])
        rows = alive[met]
        low, high = at[rows] - step, at[rows].copy()
        for _ in range(26):
            middle = 0.5 * (low + high)
            deep = inside(rows, middle)
            low, high = np.where(deep, low, middle), np.where(deep, middle, high)
        found[rows] = high
        alive = alive[~met & (at[alive] < end[alive])]
    return np.where(found <= end, found, np.inf)


def close_up(bolt: Bolt, generator: np.random.Generator, *, sigma: float = 0.03, points: int = 20000,
             elevation_deg: float = 30.0) -> tuple[Array, Array]:  # fmt: skip
    """One stud seen from the side at 300 mm: points (n, 3) and viewpoint (3,), both in the stud's frame."""
    rise = np.radians(elevation_deg)
    aim = np.array([0.0, 0.0, bolt.length / 2])
    eye = aim + 300.0 * np.array([np.cos(rise), 0.0, np.sin(rise)])
    back = (eye - aim) / 300.0
    across = np.array([0.0, 1.0, 0.0])
    up = np.cross(back, across)
    shape = (2 * bolt.radius, bolt.length * np.cos(rise))
    side = np.sqrt(shape[0] * shape[1] / points)
    u, v = np.meshgrid(np.arange(-6, 6, side), np.arange(-20, 20, side), indexing="ij")
    target = aim + u.reshape(-1, 1) * across + v.reshape(-1, 1) * up
    rays = target - eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    depth = hit(bolt, eye, rays)
    met = np.isfinite(depth)
    noisy = depth[met] + generator.normal(0, sigma, np.count_nonzero(met))
    return eye + noisy[:, None] * rays[met], eye


def flange(bolts: list[Bolt], places: Array, generator: np.random.Generator, *, pixels: int = 550,
           sigma: float = 0.03, face_mm: float = 350.0) -> NDArray[np.float32]:  # fmt: skip
    """Organised cloud (pixels, pixels, 3) of studs at `places` (n, 2) that point at the camera, without their face.

    Scanner x is the face's x, scanner y its -y: the face's frame is right-handed with its normal towards the camera.
    """
    slope = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    u, v = np.meshgrid(slope * 0.47, slope * 0.47)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    local = rays * [1.0, -1.0, -1.0]
    depth = np.full(len(rays), np.inf)
    for bolt, (x, y) in zip(bolts, places, strict=True):
        eye = np.array([-x, -y, face_mm])
        ends = np.array([[x, -y, face_mm], [x, -y, face_mm - bolt.length]])
        low, high = (ends[:, :2] / ends[:, 2:]).min(axis=0) - 0.02, (ends[:, :2] / ends[:, 2:]).max(axis=0) + 0.02
        near = np.flatnonzero(
            (u.ravel() > low[0]) & (u.ravel() < high[0]) & (v.ravel() > low[1]) & (v.ravel() < high[1])
        )
        depth[near] = np.minimum(depth[near], hit(bolt, eye, local[near]))
    depth += generator.normal(0, sigma, len(depth))
    cloud = rays * depth[:, None]
    cloud[~np.isfinite(depth)] = np.nan
    return cloud.astype(np.float32).reshape(pixels, pixels, 3)
