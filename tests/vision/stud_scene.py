"""Exact clouds of whole stud faces: rings, threaded studs of every kind, a pinhole camera anywhere, and its errors.

Independent of the twin's scene and of the fit: every stud is met by marching (`thread_scene.hit`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cellctl.vision.part import Part, Thread
from tests.vision.thread_scene import Bolt, hit

Array = NDArray[np.float64]
RINGS, BEHIND = -2, -3
"""Owners of pixels that show no stud: the face with its ledge, what lies behind the part."""


@dataclass(frozen=True)
class Errors:
    """What the instrument does: noise along the ray, which grows with cosine ** -`growth` of the incidence angle."""

    sigma_mm: float = 0.03
    growth: float = 0.0
    correlation_px: float = 0.0
    ripple_mm: float = 0.0
    outliers: float = 0.02
    flying: float = 0.0
    lost: float = 0.02
    steep_deg: float = 90.0
    missing_view: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Truth: `places` (n, 2) mm and `leans` (n, 2) rad in the part frame, one bolt each; rings (inner, outer, height)
    by radius; square image of `pixels` a side whose slope reaches +- `half_width`."""

    part: Part
    bolts: tuple[Bolt, ...]
    places: Array
    leans: Array
    T_scanner_part: Array
    pixels: int
    half_width: float
    rings: tuple[tuple[float, float, float], ...]
    errors: Errors = field(default_factory=Errors)


def directions(scene: Scene) -> Array:
    """Unit rays (pixels * pixels, 3) in the scanner frame, row by row."""
    slope = ((np.arange(scene.pixels) + 0.5) / scene.pixels * 2.0 - 1.0) * scene.half_width
    u, v = np.meshgrid(slope, slope)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def stud_frame(place: Array, lean: Array) -> tuple[Array, Array]:
    """Origin (3,) and rows x, y, s (3, 3) of a stud's frame in the part frame."""
    s = np.array([lean[0], lean[1], 1.0]) / np.sqrt(1.0 + lean @ lean)
    x = np.array([1.0, 0.0, 0.0]) - s[0] * s
    x /= np.linalg.norm(x)
    return np.append(place, 0.0), np.stack([x, np.cross(s, x), s])


def into_stud(scene: Scene, index: int, eye: Array, rays: Array) -> tuple[Array, Array]:
    """Eye (3,) and rays (n, 3) of the part frame in the frame of one stud."""
    origin, rows = stud_frame(scene.places[index], scene.leans[index])
    return rows @ (eye - origin), rays @ rows.T


def seen_from(scene: Scene) -> tuple[Array, Array]:
    """Eye (3,) and rays of all pixels (n, 3) in the part frame."""
    rotation = scene.T_scanner_part[:3, :3]
    return -rotation.T @ scene.T_scanner_part[:3, 3], directions(scene) @ rotation


def trace(scene: Scene) -> tuple[Array, NDArray[np.intp], Array]:
    """Noise-free depth (n,), NaN for nothing; what each pixel shows (stud, RINGS, BEHIND); cosine of incidence."""
    eye, rays = seen_from(scene)
    depth, owner = np.full(len(rays), np.inf), np.full(len(rays), BEHIND, dtype=np.intp)
    for inner, outer, height in scene.rings:
        t = (height - eye[2]) / rays[:, 2]
        rho = np.hypot(*(eye[:2] + t[:, None] * rays[:, :2]).T)
        met = (rho >= inner) & (rho < outer) & (t < depth)
        depth[met], owner[met] = t[met], RINGS if inner > 0 else BEHIND
    cosine = np.abs(rays[:, 2])
    for index, bolt in enumerate(scene.bolts):
        near = _window(scene, index, eye, rays)
        there, towards = into_stud(scene, index, eye, rays[near])
        found = hit(bolt, there, towards)
        first = found < depth[near]
        rows = near[first]
        depth[rows], owner[rows] = found[first], index
        cosine[rows] = incidence(bolt, there + found[first, None] * towards[first], towards[first])
    return np.where(np.isfinite(depth), depth, np.nan), owner, cosine


def _window(scene: Scene, index: int, eye: Array, rays: Array) -> NDArray[np.intp]:
    """Pixels whose ray passes near a stud's axis."""
    origin, rows = stud_frame(scene.places[index], scene.leans[index])
    bolt = scene.bolts[index]
    ends = origin + np.array([[0.0], [1.0]]) * bolt.length * rows[2]
    shown = (ends - eye) @ scene.T_scanner_part[:3, :3].T
    slopes = shown[:, :2] / shown[:, 2:]
    margin = 1.05 * bolt.radius / shown[:, 2].min() + 2.0 * scene.half_width / scene.pixels
    low, high = slopes.min(axis=0) - margin, slopes.max(axis=0) + margin
    edge = scene.pixels / 2.0 * (np.stack([low, high]) / scene.half_width + 1.0)
    (c0, r0), (c1, r1) = np.clip(np.floor(edge).astype(int) + np.array([[0], [1]]), 0, scene.pixels)
    return (np.arange(r0, r1)[:, None] * scene.pixels + np.arange(c0, c1)).ravel()


def incidence(bolt: Bolt, points: Array, rays: Array) -> Array:
    """Cosine of incidence by a numerical gradient of the bolt's height."""
    step = 1e-6
    gradient = np.stack([(bolt.height(points + step * e) - bolt.height(points - step * e)) for e in np.eye(3)], axis=1)
    flat = points[:, 2] > bolt.length - 1e-7
    gradient[flat] = [0.0, 0.0, 1.0]
    gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-30)
    return np.asarray(np.abs(np.sum(gradient * rays, axis=1)))


def render(scene: Scene, rng: np.random.Generator) -> NDArray[np.float32]:
    """Organised cloud (pixels, pixels, 3) in the scanner frame, NaN where nothing was measured."""
    return spoil(scene, *trace(scene), rng)[0]


def spoil(
    scene: Scene, depth: Array, owner: NDArray[np.intp], cosine: Array, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The cloud that the instrument makes of a noise-free trace, and which pixels (n,) show the surface they meet."""
    errors, n = scene.errors, scene.pixels
    rays = directions(scene)
    true = depth = np.where(cosine >= np.cos(np.radians(errors.steep_deg)), depth, np.nan)
    if errors.flying:
        depth = _fly(depth.reshape(n, n), errors.flying, rng).ravel()
    good = depth == true
    noise = rng.standard_normal((n, n))
    if errors.correlation_px:
        noise = ndimage.gaussian_filter(noise, errors.correlation_px / 2.0, mode="wrap")
        noise /= noise.std()
    depth = depth + errors.sigma_mm * noise.ravel() / np.maximum(cosine, 0.1) ** errors.growth
    across = (rays[:, 0] * 0.8 + rays[:, 1] * 0.6) / rays[:, 2] * scene.T_scanner_part[2, 3]
    depth += np.sqrt(2.0) * errors.ripple_mm * np.sin(across / 9.7 + 0.4)
    wild = rng.random(n * n) < errors.outliers
    good &= ~wild
    depth[wild] += rng.uniform(-15.0, 15.0, np.count_nonzero(wild))
    depth[rng.random(n * n) < errors.lost] = np.nan
    if errors.missing_view:
        image = depth.reshape(n, n)
        for _ in range(5):
            side = int(n * np.sqrt(errors.missing_view / 5.0))
            row, column = rng.integers(0, n - side, 2)
            image[row : row + side, column : column + side] = np.nan
    good &= np.isfinite(depth)
    return (rays * depth[:, None]).astype(np.float32).reshape(n, n, 3), good


def _fly(image: Array, share: float, rng: np.random.Generator) -> Array:
    """Pixels at depth edges moved to somewhere between the two surfaces."""
    true, image = image, image.copy()
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = true[there] - true[here]
        with np.errstate(invalid="ignore"):
            edge = np.nonzero((np.abs(step) > 1.5) & (rng.random(step.shape) < share))
        image[here][edge] += rng.random(len(edge[0])) * step[edge]
    return image


def random_scene(rng: np.random.Generator, points: int, *, errors: Errors | None = None) -> Scene:
    """A joint that nobody drew up: circle, count, angles, thread, length, lean, view, all at random."""
    major, pitch = [(5.0, 0.8), (6.0, 1.0), (8.0, 1.0), (8.0, 1.25), (10.0, 1.25), (10.0, 1.5), (12.0, 1.5),
                    (12.0, 1.75), (16.0, 1.5), (16.0, 2.0)][rng.integers(10)]  # fmt: skip
    starts = 2 if rng.random() < 0.12 else 1
    hand = -1 if rng.random() < 0.2 else 1
    circle = float(rng.uniform(80.0, 400.0))
    most = int(np.pi * circle / (2.2 * major))
    count = int(rng.integers(8, min(most, 96) + 1)) if most > 8 else max(4, most)
    angles = 360.0 * np.arange(count) / count
    if rng.random() < 0.5:
        angles = angles + rng.uniform(-0.3, 0.3, count) * (360.0 / count - np.degrees(2.2 * major / circle))
    length = float(rng.uniform(2.2, 4.5) * major)
    thread = Thread(major, pitch, "right" if hand > 0 else "left", starts)
    width = float(rng.uniform(2.5, 5.0) * major)
    part = Part("stud", circle, tuple(angles.tolist()), None, (major,) * count, length_mm=length, thread=thread,
                face_inner_diameter_mm=circle - width, face_outer_diameter_mm=circle + width)  # fmt: skip
    crest = 0.5 * major - float(rng.uniform(0.0, 0.07))
    kind = Bolt(radius=crest, pitch=pitch * (1.0 + rng.normal(0.0, 3e-4)), hand=hand, starts=starts,
                length=length + float(rng.normal(0.0, 0.1)))  # fmt: skip
    places = 0.5 * circle * np.column_stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))])
    face = float(rng.uniform(max(300.0, 0.62 * circle), max(400.0, 0.8 * circle)))
    tilt, turn = np.radians(rng.normal(0.0, 1.0, 2)), float(rng.uniform(-np.pi, np.pi))
    return Scene(
        part=part,
        bolts=tuple(replace(kind, phase=float(p)) for p in rng.random(count) * pitch),
        places=places + rng.normal(0.0, 0.01, (count, 2)),
        leans=np.radians(rng.normal(0.0, 0.02, (count, 2))),
        T_scanner_part=facing(face, tilt, turn, rng.normal(0.0, 2.0, 2)),
        pixels=round(points**0.5),
        half_width=(0.5 * (circle + width) + 12.0) / (face - length),
        rings=(
            (0.5 * (circle - width), 0.5 * (circle + width), 0.0),
            (0.5 * (circle + width), 0.5 * (circle + width) + 8.0, -5.0),
            (0.0, 1e9, -60.0),
        ),
        errors=errors or Errors(),
    )


def facing(distance_mm: float, tilt: Array, turn: float, shift: Array) -> Array:
    """Pose (4, 4) of a part whose z points at the scanner, tilted and turned (rad), shifted (mm)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([*tilt, turn]), np.sin([*tilt, turn])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ about_x @ about_y @ about_z
    T[:3, 3] = *shift, distance_mm
    return T
