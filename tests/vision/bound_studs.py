"""The bound on studs: Fisher information of the points delivered, labels known, white noise along the ray.

Depths and their derivatives come from the marched surface alone (`thread_scene.hit`), by central differences: nothing
here knows the fit's derivatives. Nuisance parameters free: each stud's axis, slopes, phase and lead-in; radius and
pitch are common to all studs. A pixel whose derivative jumps within the step (an edge of the surface) tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.vision.stud_scene import Scene, into_stud, seen_from
from tests.vision.thread_scene import Bolt

Array = NDArray[np.float64]

OWN = ("x", "y", "slope_x", "slope_y", "phase", "lead_in")
SHARED = ("radius", "pitch")
STEP = {"slope_x": 1e-5, "slope_y": 1e-5}
STEP_MM = 2e-4
CURVED = 0.02
"""Second difference over first difference from which a pixel is on an edge."""


@dataclass(frozen=True)
class Rows:
    """Derivatives (n, OWN) and (n, SHARED) of the true depth of each used pixel, and which pixels they are."""

    own: Array
    shared: Array
    pixels: NDArray[np.intp]


@dataclass(frozen=True)
class Bound:
    """What no estimator beats: one sigma of shared radius, pitch and clocking, covariances (n, 2, 2) of the studs'
    axes at the face, in the part frame."""

    radius_mm: float
    pitch_mm: float
    place_covariance_mm2: Array
    clocking_deg: float

    @property
    def place_mm(self) -> Array:
        """One sigma (n, 2) of x and y."""
        return np.sqrt(np.einsum("nkk->nk", self.place_covariance_mm2))

    @property
    def place_information(self) -> Array:
        """Inverse covariances (n, 2, 2)."""
        return np.asarray(np.linalg.inv(self.place_covariance_mm2))


def changed(bolt: Bolt, eye: Array, rays: Array, name: str, change: float) -> tuple[Bolt, Array, Array]:
    """Bolt, eye and rays (n, 3) in its frame once parameter `name` of the stud has changed."""
    if name in ("radius", "pitch", "phase", "lead_in"):
        return replace(bolt, **{name: getattr(bolt, name) + change}), eye, rays
    if name in ("x", "y"):
        return bolt, eye - (np.array([change, 0.0, 0.0]) if name == "x" else np.array([0.0, change, 0.0])), rays
    s = np.array([change, 0.0, 1.0]) if name == "slope_x" else np.array([0.0, change, 1.0])
    s /= np.linalg.norm(s)
    x = np.array([1.0, 0.0, 0.0]) - s[0] * s
    x /= np.linalg.norm(x)
    rows = np.stack([x, np.cross(s, x), s])
    return bolt, rows @ eye, rays @ rows.T


def polished(bolt: Bolt, eye: Array, rays: Array, depth: Array) -> Array:
    """Depth at which each ray enters the stud near `depth` (n,): secants to rounding."""
    a, b = depth - 1e-3, depth + 1e-3
    fa, fb = (bolt.height(eye + t[:, None] * rays) for t in (a, b))
    for _ in range(6):
        slope = (fb - fa) / np.where(b == a, 1.0, b - a)
        step = np.where(np.abs(slope) > 1e-9, -fb / np.where(slope == 0.0, 1.0, slope), 0.0)
        a, fa = b, fb
        b = b + np.clip(step, -0.2, 0.2)
        fb = bolt.height(eye + b[:, None] * rays)
    return np.where(np.abs(fb) < 1e-9, b, np.nan)


def derivatives(bolt: Bolt, eye: Array, rays: Array, depth: Array) -> Rows:
    """Rows of the pixels whose ray meets thread or lead-in at `depth` (n,), away from edges. Stud's frame."""
    met = np.flatnonzero((eye + depth[:, None] * rays)[:, 2] < bolt.length - 1e-6)
    depth, rays = polished(bolt, eye, rays[met], depth[met]), rays[met]
    columns, smooth = [], np.isfinite(depth)
    for name in OWN + SHARED:
        step = STEP.get(name, STEP_MM)
        ahead, behind = (polished(*changed(bolt, eye, rays, name, sign * step), depth) for sign in (1.0, -1.0))
        with np.errstate(invalid="ignore"):
            first, second = (ahead - behind) / (2.0 * step), (ahead - 2.0 * depth + behind) / step
            smooth &= np.abs(second) < CURVED * np.maximum(np.abs(first), 1.0)
        columns.append(first)
    table = np.stack(columns, axis=1)[smooth]
    return Rows(table[:, : len(OWN)], table[:, len(OWN) :], met[smooth])


def weights_of(cosine: Array, sigma_mm: float, growth: float) -> Array:
    """Inverse variance of each depth."""
    return np.asarray((np.maximum(cosine, 0.1) ** growth / sigma_mm) ** 2)


def scene_bound(
    scene: Scene,
    depth: Array,
    owner: NDArray[np.intp],
    cosine: Array,
    *,
    lean_deg: float = np.inf,
    good: NDArray[np.bool_] | None = None,
) -> Bound:
    """The bound of one scene, from its noise-free trace. `good` (n,) pixels that were delivered.

    `lean_deg` is one sigma of the studs' leans that is known beforehand; infinite where nothing is.
    """
    eye, rays = seen_from(scene)
    weight = weights_of(cosine, scene.errors.sigma_mm, scene.errors.growth)
    weight = np.where(np.isfinite(depth) & (cosine >= np.cos(np.radians(scene.errors.steep_deg))), weight, 0.0)
    if good is not None:
        weight = np.where(good, weight, 0.0)
    corner, schurs, inverses, levers = np.zeros((2, 2)), np.zeros((2, 2)), [], []
    for index, bolt in enumerate(scene.bolts):
        mine = np.flatnonzero((owner == index) & (weight > 0.0))
        rows = derivatives(bolt, *into_stud(scene, index, eye, rays[mine]), depth[mine])
        w = weight[mine[rows.pixels]][:, None]
        own = (
            rows.own.T @ (w * rows.own) + np.diag([0, 0, *[np.radians(lean_deg) ** -2.0] * 2, 0, 0]) + 1e-9 * np.eye(6)
        )
        border = rows.own.T @ (w * rows.shared)
        inverse = np.linalg.inv(own)
        corner += rows.shared.T @ (w * rows.shared)
        schurs += border.T @ inverse @ border
        inverses.append(inverse)
        levers.append(inverse @ border)
    shared = np.linalg.inv(corner - schurs)
    place = np.array([(i + lever @ shared @ lever.T)[:2, :2] for i, lever in zip(inverses, levers, strict=True)])
    _, fisher = pattern_fisher(scene.places, place)
    return Bound(
        radius_mm=float(np.sqrt(np.abs(shared[0, 0]))),
        pitch_mm=float(np.sqrt(shared[1, 1])),
        place_covariance_mm2=place,
        clocking_deg=float(np.degrees(np.sqrt(np.linalg.inv(fisher.sum(axis=0))[2, 2]))),
    )


def pattern_fisher(places: Array, covariances: Array) -> tuple[Array, Array]:
    """Design (n, 3, 2) and information (n, 3, 3) of the pattern's x, y, turn in each stud's place (n, 2)."""
    design = np.zeros((len(places), 3, 2))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 2, 0], design[:, 2, 1] = -places[:, 1], places[:, 0]
    return design, np.einsum("nki,nij,nlj->nkl", design, np.linalg.inv(covariances), design)


def close_up_bound(bolt: Bolt, eye: Array, rays: Array, depth: Array, sigmas_mm: Array) -> tuple[float, float]:
    """Radius and pitch of one stud seen alone (stud's frame): its axis, slopes and phase free."""
    rows = derivatives(bolt, eye, rays, depth)
    table = np.column_stack([rows.own[:, :5], rows.shared]) / sigmas_mm[rows.pixels, None]
    covariance = np.linalg.inv(table.T @ table)
    return float(np.sqrt(covariance[5, 5])), float(np.sqrt(covariance[6, 6]))
