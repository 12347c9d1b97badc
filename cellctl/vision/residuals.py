"""How far each point lies off what was measured: face, chamfers, walls and threads of the measurement itself. Pure.

Nothing is fitted here. A point belongs to the nearest of the surfaces; its distance is signed, positive on the open
side (proud of the face, inside a hole's void, outside of a stud).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cellctl.vision.geometry import Array, Points, inverse, robust_sigma, tangents, transform
from cellctl.vision.holes import void_radii
from cellctl.vision.part import FeatureFit, Part, PartMeasurement, ThreadFit
from cellctl.vision.pattern import nominal
from cellctl.vision.plane import RESOLUTION_MM, TUKEY
from cellctl.vision.thread_surface import FLANK
from cellctl.vision.zones import band

FACE, CHAMFER, WALL, THREAD, NONE = 0, 1, 2, 3, -1
SURFACES = ("face", "chamfer", "wall", "thread")
HALF_CREST = 1.0 / 16.0
THREAD_DEPTH = 17.0 / 24.0 * float(np.sqrt(0.75))
"""Half crest width and depth of an external thread to its root, in pitches (ISO 68-1)."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """For points (N, 3): `local_mm` (N, 3) in the part frame; `surface` (N,), NONE for points that a fit gives no
    weight; `distance_mm` (N,), NaN farther than `reach_mm` from every surface; `feature` (N,) the hole or stud whose
    place the point is in or at, -1 elsewhere. `scale_mm` (4,) is each surface's robust residual, NaN without points.
    """

    local_mm: Array
    surface: NDArray[np.int8]
    distance_mm: NDArray[np.float32]
    feature: NDArray[np.int16]
    scale_mm: Array
    reach_mm: float


def residuals(points: Points, measured: PartMeasurement, part: Part, T_frame_scanner: Array | None = None) -> Residuals:
    """Surface and signed distance (mm) of finite points (N, 3), given in the scanner's frame as they were measured.

    `T_frame_scanner` (4, 4) is the pose that the measurement was made with, None where it has none. The end of a stud
    with its lead-in is no part of a measurement, so its points lie on no surface.
    """
    T = np.eye(4) if T_frame_scanner is None else T_frame_scanner
    T_part_scanner = inverse(measured.T_frame_part) @ T
    local = transform(T_part_scanner, points)
    shapes = Shapes.of(measured, part)
    reach = max(12.0 * measured.face.sigma_mm, 0.2)
    owner, beside = _nearest(local, shapes, reach)
    distances = np.full((len(SURFACES), len(local)), np.inf)
    inner, outer = band(part, shapes.mouth)
    rho = np.hypot(local[:, 0], local[:, 1])
    near = beside < shapes.mouth[owner] + reach
    on_face = (rho > inner) & (rho < outer) & ~(beside < shapes.mouth[owner])
    distances[FACE, on_face] = local[on_face, 2]
    rows = np.flatnonzero(near & shapes.found[owner])
    if part.feature == "hole":
        distances[:, rows] = _in_hole(local[rows], owner[rows], shapes, part, distances[FACE, rows])
    else:
        zero = T_part_scanner[:3, :3] @ tangents(T_part_scanner[2, :3])[0]
        distances[:, rows] = _at_stud(local[rows], owner[rows], shapes, part, zero, distances[FACE, rows])
    return _judged(local, distances, np.where(near, owner, -1).astype(np.int16), reach)


def _judged(local: Array, distances: Array, feature: NDArray[np.int16], reach: float) -> Residuals:
    """The nearest surface of every point; what lies beyond Tukey's weight of that surface's noise is on none."""
    surface = np.abs(distances).argmin(axis=0).astype(np.int8)
    value = np.take_along_axis(distances, surface[None].astype(np.intp), axis=0)[0]
    value[~(np.abs(value) < reach)] = np.nan
    scale = np.full(len(SURFACES), np.nan)
    for kind in range(len(SURFACES)):
        mine = value[(surface == kind) & np.isfinite(value)]
        if len(mine):
            scale[kind] = max(robust_sigma(mine), RESOLUTION_MM)
    surface[~(np.abs(value) < TUKEY * scale[surface])] = NONE
    return Residuals(local, surface, value.astype(np.float32), feature, scale, reach)


@dataclass(frozen=True, slots=True)
class Shapes:
    """Features in the part frame: centre (n, 2) on the face, axis' slopes (n, 2), radius and mouth (n,), found (n,).

    The mouth is where the face ends. A feature that was not found stands at its nominal place with the mouth of the
    drawing, else with that of the others; its radius is NaN.
    """

    centre: Array
    slopes: Array
    radius: Array
    mouth: Array
    found: NDArray[np.bool_]
    threads: tuple[ThreadFit | None, ...]

    @classmethod
    def of(cls, measured: PartMeasurement, part: Part) -> Shapes:
        T = inverse(measured.T_frame_part)
        centre, slopes = nominal(part), np.zeros((part.count, 2))
        radius, mouth = np.full(part.count, np.nan), void_radii(part)
        if part.feature == "stud":
            mouth = np.full(part.count, np.nan)
        for feature in measured.features:
            if feature.center_mm is None or feature.axis is None or feature.radius_mm is None:
                continue
            i = feature.index
            axis = T[:3, :3] @ feature.axis
            centre[i], slopes[i] = transform(T, feature.center_mm)[:2], axis[:2] / axis[2]
            radius[i], mouth[i] = feature.radius_mm, _mouth(feature, part, float(mouth[i]))
        found = np.isfinite(radius)
        usual = float(np.median(mouth[found])) if found.any() else 0.0
        mouth = np.where(np.isfinite(mouth), mouth, usual)
        return cls(centre, slopes, radius, mouth, found, tuple(feature.thread for feature in measured.features))


def _mouth(feature: FeatureFit, part: Part, drawn: float) -> float:
    """Radius at which the face ends: the chamfer's as fitted, else as drawn, else the feature's own."""
    radius = float(feature.radius_mm or np.nan)
    if part.feature == "stud" or part.chamfer_diameter_mm is None:
        return radius
    return max(radius, drawn if feature.chamfer_radius_mm is None else feature.chamfer_radius_mm)


def _nearest(local: Array, shapes: Shapes, reach: float) -> tuple[NDArray[np.intp], Array]:
    """Nearest feature (N,) and distance (N,) from its axis along the face; infinite where none is near."""
    largest = float(shapes.mouth.max()) + reach
    ring = np.hypot(shapes.centre[:, 0], shapes.centre[:, 1])
    rho = np.hypot(local[:, 0], local[:, 1])
    close = np.flatnonzero((rho > ring.min() - largest) & (rho < ring.max() + largest))
    owner, beside = np.zeros(len(local), dtype=np.intp), np.full(len(local), np.inf)
    found, index = cKDTree(shapes.centre).query(local[close, :2], distance_upper_bound=largest)
    beside[close], owner[close] = found, np.where(np.isfinite(found), index, 0)
    return owner, beside


def _off_axis(local: Array, owner: NDArray[np.intp], shapes: Shapes) -> Array:
    """Offset (M, 2) of each point from the axis of its feature."""
    return np.asarray(local[:, :2] - shapes.centre[owner] - shapes.slopes[owner] * local[:, 2:])


def _in_hole(local: Array, owner: NDArray[np.intp], shapes: Shapes, part: Part, face: Array) -> Array:
    """Distances (4, M) for points in and around holes; infinite where no foot lies on that surface."""
    rho, height = np.hypot(*_off_axis(local, owner, shapes).T), local[:, 2]
    mouth, wall = shapes.mouth[owner], shapes.radius[owner]
    slope = float(np.tan(np.radians(part.chamfer_angle_deg or 45.0)))
    cosine = 1.0 / np.sqrt(1.0 + slope**2)
    # how far down the cone's generatrix from the mouth, and the generatrix' length
    down = -((rho - mouth) * slope + height) * cosine
    length = (mouth - wall) / (slope * cosine)
    result = np.full((len(SURFACES), len(local)), np.inf)
    result[FACE] = face
    cone = (down >= 0.0) & (down <= length) & (length > 0.0)
    result[CHAMFER, cone] = ((mouth - rho + slope * height) * cosine)[cone]
    inside = (height <= -(mouth - wall) / slope) & (height > -(part.depth_mm or np.inf))
    result[WALL, inside] = (wall - rho)[inside]
    return result


def _at_stud(local: Array, owner: NDArray[np.intp], shapes: Shapes, part: Part, zero: Array, face: Array) -> Array:
    """Distances (4, M) for points on studs. `zero` (3,) is the direction that a thread's phase counts from."""
    offset = _off_axis(local, owner, shapes)
    along = local[:, 2] + (shapes.slopes[owner] * offset).sum(axis=1)
    rho, radius = np.hypot(*offset.T), shapes.radius[owner]
    length = part.length_mm or np.inf
    result = np.full((len(SURFACES), len(local)), np.inf)
    result[FACE] = face
    thread = next((each for each in shapes.threads if each is not None), None)
    end = thread.pitch_mm if thread is not None else 0.25 * float(np.nanmedian(shapes.radius))
    side = (along > 0.03 * length) & (along < length - end)
    if thread is None:
        result[WALL, side] = (rho - radius)[side]
        return result
    turn = np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(zero[1], zero[0])
    phase = np.array([np.nan if each is None else each.phase_rad for each in shapes.threads])[owner] / (2.0 * np.pi)
    hand = thread.starts if thread.hand == "right" else -thread.starts
    turns = along / thread.pitch_mm - phase - hand * turn / (2.0 * np.pi)
    off = np.abs(turns - np.rint(turns))
    flank = 0.5 * (rho - radius + FLANK * (off - HALF_CREST) * thread.pitch_mm)
    on = side & (off < HALF_CREST + THREAD_DEPTH / FLANK)
    result[THREAD, on] = np.maximum(rho - radius, flank)[on]
    return result
