"""Structured-light scans of a tool flange with the artefacts of real ones, drawn at random.

A pinhole camera at the origin looks along z, a projector stands beside it. What the camera sees is blurred by a point
spread function; where brightness changes along the baseline, the phase, and with it the depth, is that of the brighter
side: rims facing the projector are dropped, those facing away are lifted. Part frame as in `cellctl.vision.part`.

How sizes and artefacts are drawn follows what two real scans and the drawing of their flange show: rims that reach
farther into tapped holes than into the key hole, next to nothing lost near them (1 % of the face), walls and threads
that send groups of wrong points into every tapped hole at the same side, pixels of 0.44 mrad whose grid a lens bends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter1d

from cellctl.vision.geometry import pose

Array = NDArray[np.float64]
Bits = NDArray[np.bool_]
Rng = np.random.Generator

ANGLES_DEG = np.array([0.0, 45.0, 135.0, 225.0, 315.0])
CENTRES = 25.0 * np.column_stack([np.cos(np.radians(ANGLES_DEG)), np.sin(np.radians(ANGLES_DEG))])
BORE_MM, RIM_MM = 15.75, 31.5
SUB = 2  # rays per pixel and direction
SEEN_DEPTH_MM, STEP_MM = 6.5, 0.15  # how deep walls and floors are looked for, and how finely


@dataclass(frozen=True)
class Flange:
    """What the drawing leaves open. Depths and sizes in mm; `slots` are kidneys: (angle, half width) in degrees."""

    mouth_mm: float = 3.0
    key_mouth_mm: float = 3.2
    thread_mm: float = 0.45
    rounding_mm: float = 0.2
    chamfer_mm: float = 0.6
    depth_mm: float = 9.0
    recess_mm: float = 6.0
    slots: tuple[tuple[float, float], ...] = ()
    offsets_mm: Array | None = None
    bolts: tuple[int, ...] = ()
    bolt_mm: float = 3.0


@dataclass(frozen=True)
class Scan:
    """How it is seen: `T_scanner_part` (4, 4), angle of a pixel, and the size of every artefact (0 switches it off).

    `lost` is the share of the face that shows no points, `torn` the share of rims lost on top, `spread_px` the point
    spread, `glints` the number of patches that an interreflection lifts or drops, `strays` of point groups in holes.
    `ghost_mm` is the half length of the group that lies in every tapped hole on its side `ghost_rad` (part frame).
    """

    T_scanner_part: Array
    flange: Flange = Flange()
    pixel_rad: float = 4.5e-4
    sigma_mm: float = 0.05
    correlation_px: float = 1.0
    spread_px: float = 0.6
    baseline_rad: float = 0.0
    triangulation: float = 2.5
    dark: float = 0.08
    halo: float = 0.1
    halo_px: float = 3.0
    flare_mm: float = 0.8
    bow_mm: float = 0.12
    lost: float = 0.08
    torn: float = 0.1
    shade_mm: float = 0.3
    glints: int = 2
    glint_mm: float = 0.3
    strays: int = 6
    wall: float = 0.6
    ghost_mm: float = 0.7
    ghost_rad: float = 0.0
    behind: bool = True
    occluder: bool = False
    lattice: bool = True
    half_field_mm: float = 40.0


def random_pose(rng: Rng, *, tilt_deg: float) -> Array:
    """Part z towards the camera, tilted about any direction, any clocking, 0.55 to 0.95 m away, off the axis."""
    away = rng.uniform(0.0, 2.0 * np.pi)
    tilt, turn = np.radians(tilt_deg), rng.uniform(0.0, 2.0 * np.pi)
    place = np.array([rng.uniform(-150.0, 150.0), rng.uniform(-200.0, 200.0), rng.uniform(550.0, 950.0)])
    z = -place / np.linalg.norm(place)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    z = np.cos(tilt) * z + np.sin(tilt) * (np.cos(away) * x + np.sin(away) * y)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    first = np.cos(turn) * x + np.sin(turn) * y
    return pose(np.column_stack([first, np.cross(z, first), z]), place)


def random_scan(rng: Rng) -> Scan:
    """One scan: every size and artefact drawn on its own."""
    slots = ((90.0, 25.0), (180.0, 25.0), (270.0, 25.0)) if rng.random() < 0.5 else ()
    flange = Flange(
        mouth_mm=rng.uniform(2.6, 3.1), key_mouth_mm=rng.uniform(3.0, 3.3), thread_mm=rng.uniform(0.2, 0.55),
        rounding_mm=rng.uniform(0.05, 0.4), chamfer_mm=rng.uniform(0.2, 1.2), depth_mm=rng.uniform(5.0, 14.0),
        recess_mm=rng.uniform(4.0, 8.0),
        slots=tuple(slot for slot in slots if rng.random() < 0.8), offsets_mm=rng.normal(0.0, 0.01, (5, 2)),
        bolts=tuple(k for k in range(1, 5) if rng.random() < 0.06), bolt_mm=rng.uniform(1.0, 5.0),
    )  # fmt: skip
    T = random_pose(rng, tilt_deg=rng.uniform(0.0, 35.0))
    return Scan(
        T, flange, pixel_rad=rng.uniform(4.0e-4, 5.0e-4), sigma_mm=rng.uniform(0.03, 0.08),
        correlation_px=rng.uniform(0.5, 1.5), spread_px=rng.uniform(0.5, 1.0), baseline_rad=rng.uniform(0.0, 2 * np.pi),
        triangulation=rng.uniform(1.5, 3.5), dark=rng.uniform(0.03, 0.3), halo=rng.uniform(0.02, 0.15),
        halo_px=rng.uniform(2.0, 4.0), flare_mm=rng.uniform(0.4, 1.2), bow_mm=rng.uniform(0.0, 0.2),
        lost=0.2 * rng.random() ** 4, torn=0.12 * rng.random() ** 4, shade_mm=rng.choice([0.0, rng.uniform(0.0, 0.5)]),
        glints=int(rng.integers(0, 4)), glint_mm=rng.uniform(0.1, 0.5), strays=int(rng.integers(0, 12)),
        wall=rng.uniform(0.4, 1.0), ghost_mm=rng.uniform(0.2, 1.2), ghost_rad=rng.uniform(0.0, 2.0 * np.pi),
        behind=rng.random() < 0.6, occluder=rng.random() < 0.15, lattice=rng.random() < 0.5,
        half_field_mm=rng.uniform(34.0, 50.0),
    )  # fmt: skip


def render(scan: Scan, rng: Rng) -> NDArray[np.float32]:
    """Cloud (N, 3) in the scanner frame: the pixels that came through, in rows, or shuffled where not on a lattice."""
    rays, shape = _rays(scan, rng)
    eye = -scan.T_scanner_part[:3, :3].T @ scan.T_scanner_part[:3, 3]
    local = rays @ scan.T_scanner_part[:3, :3]
    range_mm, bright = _cast(scan, eye, local, rng)
    height = (eye + range_mm[:, None] * local)[:, 2].reshape(shape)
    on_face = np.abs(height) < 0.02
    pitch = scan.pixel_rad * scan.T_scanner_part[2, 3]
    middle = (slice(SUB // 2, None, SUB),) * 2
    seen, blurred, jump, wrong = (
        image[middle] for image in _blur(scan, bright.reshape(shape), range_mm.reshape(shape), pitch)
    )
    on_face = on_face[middle]
    texture = 1.0 + 0.1 * _smooth(on_face.shape, 5.0 / pitch, rng)
    valid = (seen * texture > scan.dark) & (jump < 1.5) & (np.abs(wrong) < scan.flare_mm)
    valid &= ~_lost(scan, on_face, pitch, rng)
    noise = scan.sigma_mm * _smooth(on_face.shape, scan.correlation_px, rng)
    depth = blurred + wrong + noise / np.sqrt(np.clip(seen, 0.05, 1.0)) + _warp(scan, on_face, pitch, rng)
    picked = rays.reshape(*shape, 3)[middle]
    face_range = (-eye[2] / local[:, 2]).reshape(shape)[middle]
    _add_strays(scan, on_face, depth, face_range, valid, rng)
    face_at = eye + face_range[..., None] * local.reshape(*shape, 3)[middle]
    _add_ghosts(scan, face_at[..., :2], depth, face_range, valid, rng)
    cloud = (picked * depth[..., None])[valid]
    return np.asarray(cloud if scan.lattice else rng.permutation(cloud), dtype=np.float32)


def _blur(scan: Scan, bright: Array, range_mm: Array, pitch: float) -> tuple[Array, Array, Array, Array]:
    """Brightness, range, its variance within the point spread, and depth error, each of the rays' shape.

    What a Gaussian point spread mixes has its centroid spread^2 times the slope of log brightness away: that far along
    the baseline the phase is wrong. A weak halo reaches farther into the dark than the core.
    """
    core = scan.spread_px * SUB
    sharp = gaussian_filter(bright, core)
    soft = gaussian_filter(bright, scan.halo_px * SUB)
    seen = (1.0 - scan.halo) * sharp + scan.halo * soft
    blurred = gaussian_filter(bright * range_mm, core) / np.maximum(sharp, 1e-6)
    jump = gaussian_filter(bright * range_mm**2, core) / np.maximum(sharp, 1e-6) - blurred**2
    pull = (1.0 - scan.halo) * scan.spread_px**2 * sharp + scan.halo * scan.halo_px**2 * soft
    gu, gv = np.gradient(pull, pitch / SUB)
    shift = pitch**2 * (np.cos(scan.baseline_rad) * gu + np.sin(scan.baseline_rad) * gv) / np.maximum(seen, 1e-6)
    return seen, blurred, jump, scan.triangulation * shift


def _rays(scan: Scan, rng: Rng) -> tuple[Array, tuple[int, int]]:
    """Unit directions (H * W, 3) of a window about the flange, `SUB` rays a pixel; off a lattice a lens bends them."""
    place = scan.T_scanner_part[:3, 3]
    step = scan.pixel_rad / SUB
    half = round(scan.half_field_mm / place[2] / step / SUB) * SUB
    axis = np.arange(-half, half + 1) * step
    u, v = np.meshgrid(axis + place[0] / place[2], axis + place[1] / place[2], indexing="ij")
    if not scan.lattice:
        u, v = (w + 1.2 * SUB * step * _smooth(u.shape, 25.0 * SUB, rng) for w in (u, v))
    rays = np.dstack([u, v, np.ones_like(u)]).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), u.shape


def _smooth(shape: tuple[int, ...], length: float, rng: Rng) -> Array:
    """A random field of unit variance, smooth over about `length` cells."""
    field = gaussian_filter(rng.standard_normal(shape), length, mode="wrap")
    return np.asarray(field / field.std())


def _cast(scan: Scan, eye: Array, rays: Array, rng: Rng) -> tuple[Array, Array]:
    """Range (N,) and brightness (N,) of what each ray meets. Part frame; 0 brightness where nothing is met."""
    flange = scan.flange
    far = _background(scan, eye, rays, rng)
    start = -eye[2] / rays[:, 2]
    at = eye + start[:, None] * rays
    rho = np.hypot(at[:, 0], at[:, 1])
    solid = np.zeros(len(rays), dtype=np.bool_)
    face = np.flatnonzero((rho > BORE_MM) & (rho < RIM_MM))
    solid[face] = _solid(flange, at[face] - 1e-6)
    range_mm = np.where(solid, start, far)
    bright = np.where(solid, 1.0, np.where(np.isfinite(far), rng.uniform(0.2, 1.0), 0.0))
    # what enters the bore far from its wall meets nothing: its floor is a narrow ring
    left = np.flatnonzero(~solid & (rho > BORE_MM - 0.7 * SEEN_DEPTH_MM) & (rho < RIM_MM + 2.0))
    for travelled in np.arange(STEP_MM, SEEN_DEPTH_MM * 1.2, STEP_MM):
        t = start[left] + travelled
        hit = _solid(flange, eye + t[:, None] * rays[left])
        found = left[hit]
        range_mm[found] = t[hit] - 0.5 * STEP_MM
        bright[found] = _wall_brightness(scan, eye + range_mm[found, None] * rays[found])
        left = left[~hit]
    blind = (np.hypot(*(at[left, None, :2] - CENTRES).transpose(2, 0, 1)) < 4.0).any(axis=1)
    range_mm[left[blind]] = np.inf
    if scan.occluder:
        t = (rng.uniform(8.0, 30.0) - eye[2]) / rays[:, 2]
        spot = eye + t[:, None] * rays
        angle, off = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(27.0, 31.0)
        front = (np.cos(angle) * spot[:, 0] + np.sin(angle) * spot[:, 1] > off) & (
            np.abs(np.cos(angle) * spot[:, 1] - np.sin(angle) * spot[:, 0]) < 12.0
        )
        range_mm[front], bright[front] = t[front], 0.8
    return np.where(np.isfinite(range_mm), range_mm, 0.0), np.where(np.isfinite(range_mm), bright, 0.0)


def _wall_brightness(scan: Scan, at: Array) -> Array:
    """Walls and floors (n, 3): dim, dimmer with depth, and dark where the projector does not reach."""
    u, v = _baseline(scan)
    slant = 1.0 / max(scan.triangulation, 0.5)
    mouth = at + np.outer(-at[:, 2], [slant * u, slant * v, 1.0])
    lit = np.ones(len(at), dtype=np.bool_)
    for share in (0.1, 0.3, 0.6, 1.0):
        lit &= ~_solid(scan.flange, at + share * (mouth - at) - [0.0, 0.0, 1e-3])
    return np.asarray(np.where(lit, scan.wall * np.exp(at[:, 2] / 3.0), 0.04))


def _baseline(scan: Scan) -> Array:
    """Direction (2,) of the projector in the part's face."""
    across = np.array([np.cos(scan.baseline_rad), np.sin(scan.baseline_rad), 0.0])
    return np.asarray((scan.T_scanner_part[:3, :3].T @ across)[:2])


def _solid(flange: Flange, at: Array) -> Bits:
    """Which points (n, 3) lie in the part's material."""
    z = np.minimum(at[:, 2], 0.0)
    rho = np.hypot(at[:, 0], at[:, 1])
    lip = np.maximum(0.0, z + flange.rounding_mm)
    lip = flange.rounding_mm - np.sqrt(np.maximum(flange.rounding_mm**2 - lip**2, 0.0))
    solid = (rho < RIM_MM - np.maximum(0.0, z + flange.chamfer_mm)) & (at[:, 2] <= 0.0)
    solid &= (rho > BORE_MM + lip) | ((z < -flange.recess_mm) & (rho > 10.0))
    for angle, half in flange.slots:
        turn = np.angle(np.exp(1j * (np.arctan2(at[:, 1], at[:, 0]) - np.radians(angle))))
        end = np.clip(turn, -np.radians(half), np.radians(half)) + np.radians(angle)
        solid &= np.hypot(at[:, 0] - 23.0 * np.cos(end), at[:, 1] - 23.0 * np.sin(end)) > 5.2 + lip
    drilled = CENTRES if flange.offsets_mm is None else CENTRES + flange.offsets_mm
    nearest = np.argmax(at[:, :2] @ CENTRES.T, axis=1)
    from_axis = np.hypot(*(at[:, :2] - drilled[nearest]).T)
    # the countersink runs into the thread, or the key hole, at 45 degrees
    tapped = np.maximum(3.0 - flange.thread_mm * np.abs(np.mod(z, 1.0) - 0.5) * 2.0, flange.mouth_mm + z)
    floors = np.full(len(CENTRES), flange.depth_mm)
    floors[list(flange.bolts)] = flange.bolt_mm
    plain = np.maximum(3.0, flange.key_mouth_mm + z)
    solid &= (from_axis > np.where(nearest == 0, plain, tapped) + lip) | (z < -floors[nearest])
    return np.asarray(solid)


def _background(scan: Scan, eye: Array, rays: Array, rng: Rng) -> Array:
    """Range (N,) of the robot and the table behind, infinite where there is nothing."""
    far = np.full(len(rays), np.inf)
    if not scan.behind:
        return far
    radius, depth = rng.uniform(38.0, 60.0), rng.uniform(10.0, 40.0)
    t = (-depth - eye[2]) / rays[:, 2]
    spot = eye + t[:, None] * rays
    wrist = np.hypot(spot[:, 0] - rng.uniform(-8, 8), spot[:, 1] - rng.uniform(-8, 8)) < radius
    far[wrist] = t[wrist]
    if rng.random() < 0.5:
        normal = np.append(rng.normal(0.0, 0.4, 2), 1.0)
        t = (-rng.uniform(60.0, 250.0) - eye @ normal) / (rays @ normal)
        far = np.where(np.isfinite(far) | (t <= 0.0), far, t)
    return far


def _lost(scan: Scan, on_face: Bits, pitch: float, rng: Rng) -> Bits:
    """Pixels that show no point: specular patches, torn rims, the side of the rims that the projector leaves dark."""
    field = _smooth(on_face.shape, rng.uniform(2.0, 5.0) / pitch, rng)
    lost = np.asarray(field > np.quantile(field[on_face], 1.0 - scan.lost))
    edge = gaussian_filter(on_face.astype(float), 1.5) < 0.98
    ragged = _smooth(on_face.shape, rng.uniform(0.5, 1.5) / pitch, rng)
    lost |= edge & (ragged > np.quantile(ragged, 1.0 - scan.torn))
    reach = round(scan.shade_mm / pitch)
    if reach:
        axis, side = rng.integers(0, 2), int(rng.choice([-1, 1]))
        void = (~on_face).astype(np.int8)
        grown = maximum_filter1d(void, reach + 1, axis=axis, origin=side * (reach // 2))
        lost |= (grown > 0) & on_face & (_smooth(on_face.shape, 1.0 / pitch, rng) > -0.5)
    return np.asarray(lost | (rng.random(on_face.shape) < 0.005))


def _warp(scan: Scan, on_face: Bits, pitch: float, rng: Rng) -> Array:
    """Depth error (H, W) of the calibration (bowed) and of interreflections (soft patches)."""
    shape = on_face.shape
    bow = _smooth(shape, rng.uniform(15.0, 30.0) / pitch, rng)
    span = float(np.ptp(bow[on_face]))
    total = scan.bow_mm * bow / max(span, 1e-9)
    for _ in range(scan.glints):
        field = _smooth(shape, rng.uniform(1.0, 3.0) / pitch, rng)
        soft = np.clip(4.0 * (field - np.quantile(field, 0.97)), 0.0, 1.0)
        total = total + scan.glint_mm * rng.choice([-1.0, 1.0]) * soft
    return np.asarray(total)


def _add_strays(scan: Scan, on_face: Bits, depth: Array, face_range: Array, valid: Bits, rng: Rng) -> None:
    """Groups of wrong points just inside voids, lifted or dropped by up to 1 mm, some of them much deeper. In place."""
    inside = gaussian_filter(on_face.astype(float), 2.0)
    places = np.argwhere((inside > 0.05) & (inside < 0.45) & ~on_face)
    if not len(places):
        return
    for u, v in places[rng.integers(0, len(places), 3 * scan.strays)]:
        length = int(rng.integers(2, 6))
        walk = np.cumsum(rng.integers(-1, 2, (length, 2)), axis=0) + np.array([u, v])
        walk = np.clip(walk, 0, np.array(valid.shape) - 1)
        off = rng.uniform(-1.0, 1.0) if rng.random() < 0.8 else rng.uniform(1.0, 12.0)
        rows, columns = walk.T
        depth[rows, columns] = face_range[rows, columns] + off + rng.normal(0.0, 0.1, length)
        valid[rows, columns] = True


def _add_ghosts(scan: Scan, at: Array, depth: Array, face_range: Array, valid: Bits, rng: Rng) -> None:
    """What thread and floor throw into each other: one slim group of points within every tapped hole. In place.

    `at` (H, W, 2) is where each pixel's ray meets the face.
    """
    for centre in CENTRES[1:]:
        way = scan.ghost_rad + rng.normal(0.0, 0.15)
        middle = centre + rng.uniform(1.3, 2.3) * np.array([np.cos(way), np.sin(way)])
        lean, length = way + rng.normal(0.0, 0.5), scan.ghost_mm * rng.uniform(0.5, 1.5)
        along, across = np.moveaxis((at - middle) @ np.array(
            [[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]]), -1, 0)  # fmt: skip
        inside = np.hypot(*np.moveaxis(at - centre, -1, 0)) < scan.flange.mouth_mm
        group = inside & (np.abs(along) < length) & (np.abs(across) < 0.45)
        off = rng.normal(0.0, 0.4) + rng.uniform(-0.6, 0.6) * along[group] + rng.normal(0.0, 0.15, group.sum())
        depth[group] = face_range[group] + off
        valid[group] = True
