"""Which of the planes in view is the part's face: the one whose voids or studs make the nominal pattern."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array, PlaneFrame
from cellctl.vision.grid import Void, find_islands, find_voids, rasterise, spacing
from cellctl.vision.holes import EDGE_BAND, void_radii
from cellctl.vision.likeness import by_likeness
from cellctl.vision.part import Part, Refused
from cellctl.vision.pattern import CLEAR_MARGIN, PatternPose, find_patterns, nominal, symmetry
from cellctl.vision.plane import Plane, find_planes

RANSAC_POINTS = 12_000
MAX_NOISE_MM = 0.5
CELLS_PER_SPACING = 1.6
RIVALS, MOST_RIVALS = 0.25, 8  # poses that score so much less, per feature, are told apart by their outlines
LEAST_LIKENESS = 0.25  # per feature: chance voids in a few of the places are no pattern
THINNED_POINTS = 120_000
"""As many points show where the face and its pattern are; finer sampling serves the fits."""


@dataclass(frozen=True, slots=True)
class Face:
    """The face found: its plane, a frame with origin at the pattern's centre and u through its zero angle (part frame,
    approximate), point spacing, radii (n,) of the features' voids, pattern pose in the frame it was found in."""

    plane: Plane
    frame: PlaneFrame
    spacing_mm: float
    radii_mm: Array
    pattern: PatternPose


@dataclass(frozen=True, slots=True)
class _Thinned:
    """A share of the points, evenly spread; `cells` is the raster's cell in spacings that leaves no gaps."""

    points: Columns
    share: float
    cells: float


def find_face(points: Columns, part: Part, eye: Array, reference: Array, rng: np.random.Generator) -> Face:
    """The face among clutter. `eye` (3,) is the side it is seen from, `reference` (3,) the direction that a clocking of
    0 is nearest to.

    Raises Refused: face_not_found, too_noisy, too_coarse, features_missing, pattern_ambiguous.
    """
    some = points if len(points) <= RANSAC_POINTS else points.take(rng.integers(0, len(points), RANSAC_POINTS))
    densities = [_Thinned(points, 1.0, CELLS_PER_SPACING)]
    if len(points) > 2 * THINNED_POINTS and part.diameter_mm is not None:
        densities.insert(0, _thinned(points, rng))
    best: Face | None = None
    refusal: Refused | None = None
    seen = 0
    for seen, plane in enumerate(find_planes(some.stacked(), rng), start=1):
        if seen == 1 and plane.sigma_mm > MAX_NOISE_MM:
            raise Refused("too_noisy", f"the largest plane scatters by {plane.sigma_mm:.2f} mm")
        try:
            face = _try_plane(densities, plane, part, eye, reference)
        except Refused as error:
            refusal = refusal or error
            continue
        # planes come largest first: a smaller one must show the pattern plainly better
        if face is not None and (best is None or face.pattern.score > best.pattern.score + 0.1 * part.count):
            best = face
        if best is not None and best.pattern.matched == part.count and best.pattern.score > 0.8 * part.count:
            break
    if seen == 0:
        raise Refused("face_not_found", "no plane was found in the cloud")
    if best is None:
        raise refusal or Refused("features_missing", "no plane in view carries the nominal pattern")
    return best


def _thinned(points: Columns, rng: np.random.Generator) -> _Thinned:
    """Every so many-th row and column of a grid, or a random share of an unorganised cloud."""
    if points.pixels is None:
        chosen = np.unique(rng.integers(0, len(points), 2 * THINNED_POINTS))
        return _Thinned(points.take(chosen), len(chosen) / len(points), 1.4 * CELLS_PER_SPACING)
    step = int(np.ceil(np.sqrt(len(points) / THINNED_POINTS)))
    height, width = points.shape
    picked = np.zeros((height, width), dtype=np.bool_)
    picked[::step, ::step] = True
    chosen = np.flatnonzero(picked.reshape(-1)[points.pixels])
    return _Thinned(points.take(chosen), 1.0 / step**2, CELLS_PER_SPACING)


def _try_plane(densities: list[_Thinned], plane: Plane, part: Part, eye: Array, reference: Array) -> Face | None:
    """The plane with the pattern on it, None where none shows. Thinned points serve where they are fine enough."""
    toward = plane.normal if plane.residuals(eye) > 0.0 else -plane.normal
    frame = PlaneFrame.on(plane.normal * plane.distance_mm, toward)
    for thinned in densities:
        local = thinned.points.into(frame)
        on = np.abs(local.z) < 5.0 * plane.sigma_mm
        if np.count_nonzero(on) < 100:
            return None
        uv = np.stack([local.x[on], local.y[on]], axis=1, dtype=np.float64)
        space = spacing(uv, coarse_mm=0.012 * part.circle_diameter_mm + 1.0)
        if thinned is densities[-1] or _fine_enough(part, thinned.cells * space):
            break
    voids = _holes(uv, part, space, thinned.cells) if part.feature == "hole" else _studs(local, part, space)
    if len(voids) < 3:
        return None
    positions = np.stack([void.position_mm for void in voids])
    radii = np.array([void.radius_mm for void in voids])
    # chance voids are small: a large one weighs more, up to the usual size
    scores = np.array([void.score for void in voids]) * np.minimum(1.0, radii / np.quantile(radii, 0.75)) ** 2
    tolerance = max(0.006 * part.circle_diameter_mm, 2.0 * space)
    least = max(3, int(np.ceil(0.5 * part.count)))
    rivals = find_patterns(part, positions, radii, scores, tolerance, within=max(1.0, RIVALS * part.count))
    rivals = [pattern for pattern in rivals if pattern.matched >= least]
    if part.feature == "hole" and (len(rivals) > 1 or any(pattern.matched < part.count for pattern in rivals)):
        edge = np.abs(local.z) < max(4.0 * plane.sigma_mm, EDGE_BAND * space)
        face = np.stack([local.x[edge], local.y[edge]], axis=1, dtype=np.float64)
        sizes = [_matched_radii(part, pose, positions, radii) for pose in rivals[:MOST_RIVALS]]
        judged = by_likeness(rivals[:MOST_RIVALS], face, part, np.stack(sizes), space) if rivals else []
        rivals = [pose for pose in judged if pose.score > LEAST_LIKENESS * part.count]
    if not rivals:
        return None
    if len(rivals) > 1 and rivals[1].score > rivals[0].score - CLEAR_MARGIN:
        raise Refused("pattern_ambiguous", "two clockings of the pattern are met equally well")
    pattern = _nearest_to(rivals[0], frame, part, reference)
    radii = _matched_radii(part, pattern, positions, radii)
    return Face(plane, _pattern_frame(frame, pattern), space * float(np.sqrt(thinned.share)), radii, pattern)


def _fine_enough(part: Part, cell_mm: float) -> bool:
    """Whether a raster with such cells shows the part's features: a hole's radius is at least three cells."""
    return part.feature == "hole" and 3.0 * cell_mm < float(np.nanmin(void_radii(part)))


def _holes(uv: Array, part: Part, space: float, cells: float) -> list[Void]:
    """Voids of about the expected sizes. Without sizes in the recipe a range of sizes is looked for."""
    expected = void_radii(part)
    known = np.unique(expected[np.isfinite(expected)])
    centres = nominal(part)
    gap = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    largest = 0.4 * float(gap[gap > 1e-6].min())
    if len(known):
        # a recipe may give a tapped hole's core, whose chamfered mouth is what the face shows
        radii = np.unique(
            np.round(np.concatenate([known, known * (1.2 if part.chamfer_diameter_mm is None else 1.0)]), 3)
        )
    else:
        radii = np.geomspace(3.0 * space, largest, 9) if largest > 3.0 * space else np.array([largest])
    if float(radii.min()) < 1.6 * space:
        raise Refused("too_coarse", f"point spacing {space:.2f} mm is too coarse for holes of {2 * radii.min():.1f} mm")
    raster = rasterise(uv, cells * space, margin_mm=float(radii.max()))
    return find_voids(raster, tuple(float(radius) for radius in radii))


def _studs(local: Columns, part: Part, space: float) -> list[Void]:
    """Groups of points as high above the plane as the outer half of a stud."""
    length = part.length_mm or 0.1 * part.circle_diameter_mm
    above = (local.z > 0.6 * length) & (local.z < 1.03 * length)
    if np.count_nonzero(above) < 3 * part.count:
        return []
    uv = np.stack([local.x[above], local.y[above]], axis=1, dtype=np.float64)
    size = part.thread.major_diameter_mm if part.thread else (part.diameter_mm or (0.03 * part.circle_diameter_mm,))[0]
    raster = rasterise(uv, max(space, 0.1 * size), margin_mm=size)
    return [void for void in find_islands(raster, least=6) if void.radius_mm < 1.5 * size]


def _nearest_to(pattern: PatternPose, frame: PlaneFrame, part: Part, reference: Array) -> PatternPose:
    """The same pose with the clocking, free by the pattern's symmetry, that lies nearest to the reference direction."""
    u, v, _ = frame.axes @ reference
    step = 2.0 * np.pi / symmetry(part)
    turns = round((float(np.arctan2(v, u)) - pattern.clocking_rad) / step)
    return replace(pattern, clocking_rad=pattern.clocking_rad + turns * step)


def _pattern_frame(frame: PlaneFrame, pattern: PatternPose) -> PlaneFrame:
    """The part's approximate frame from the pattern's pose in a frame on the same plane."""
    c, s = np.cos(pattern.clocking_rad), np.sin(pattern.clocking_rad)
    origin = frame.out(np.append(pattern.centre_mm, 0.0))
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return PlaneFrame(origin, turn @ frame.axes)


def _matched_radii(part: Part, pattern: PatternPose, positions: Array, radii: Array) -> Array:
    """Radius of the void at each nominal place: the one seen there, else what the recipe or the others say."""
    c, s = np.cos(pattern.clocking_rad), np.sin(pattern.clocking_rad)
    places = pattern.centre_mm + nominal(part) @ np.array([[c, s], [-s, c]])
    distance = np.hypot(*(places[:, None] - positions[None]).transpose(2, 0, 1))
    nearest = distance.argmin(axis=1)
    seen = np.where(distance[np.arange(part.count), nearest] < radii[nearest], radii[nearest], np.nan)
    expected = void_radii(part)
    if part.diameter_mm is None and np.isfinite(seen).any():  # a torn void looks smaller than it is
        middle = float(np.nanmedian(seen))
        seen = np.where((seen > 0.85 * middle) & (seen < 2.0 * middle), seen, middle)
    usual = float(np.nanmedian(seen / expected)) if np.isfinite(seen / expected).any() else 1.0
    # a chamfered mouth is known from the drawing; a tapped one is what the face shows
    guess = expected if part.chamfer_diameter_mm is not None else np.where(np.isfinite(seen), seen, expected * usual)
    if np.isfinite(guess).all() or not np.isfinite(seen).any():
        return np.asarray(guess)
    return np.asarray(np.where(np.isfinite(guess), guess, np.nanmedian(seen)))
