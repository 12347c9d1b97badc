"""Which of the planes in view is the part's face: the one whose voids or studs make the nominal pattern."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array, PlaneFrame
from cellctl.vision.grid import Void, find_voids, rasterise, spacing
from cellctl.vision.holes import void_radii
from cellctl.vision.likeness import by_likeness
from cellctl.vision.outline import edge_band_mm
from cellctl.vision.part import Part, Refused
from cellctl.vision.pattern import CLEAR_MARGIN, PatternPose, blind_to_sizes, find_patterns, nominal, placed, symmetry
from cellctl.vision.plane import Plane, find_planes
from cellctl.vision.stud_tips import LEAST_HEIGHT_MM, find_tips, radius_of, standing, tip_levels

RANSAC_POINTS = 12_000
MAX_NOISE_MM = 0.5
LEAST_DISTANCE_MM = 100.0
ENOUGH_PLANES = 4  # smaller ones are looked at only where these show no pattern
CLEAR_SIDE, SIDE_POINTS = 4.0, 200_000
"""Standard deviations by which the holes tell the side, and how many points are looked at."""
RIVALS, MOST_RIVALS = 0.25, 8  # poses that score so much less, per feature, are told apart by their outlines
SECOND = 0.5  # score per feature from which on a pose elsewhere is a second part
LEAST_LIKENESS = 0.25  # per feature: chance voids in a few of the places are no pattern
CELLS_PER_SPACING, CELLS_PER_RADIUS = 1.6, 4.0
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


class _Ambiguous(Refused):
    """A plane (pattern_ambiguous) that shows the pattern with this score, but not where or how it is turned."""

    def __init__(self, reason: str, score: float) -> None:
        super().__init__("pattern_ambiguous", reason)
        self.score = score


def find_face(points: Columns, part: Part, eye: Array | None, reference: Array, rng: np.random.Generator) -> Face:
    """The face among clutter. `eye` (3,) is the side it is seen from, None where only the points can tell; `reference`
    (3,) the direction that a clocking of 0 is nearest to.

    Raises Refused: face_not_found, too_noisy, too_coarse, features_missing, pattern_ambiguous.
    """
    some = points if len(points) <= RANSAC_POINTS else points.take(rng.integers(0, len(points), RANSAC_POINTS))
    densities = [_Thinned(points, 1.0, CELLS_PER_SPACING)]
    sized = part.diameter_mm is not None or (part.feature == "stud" and part.thread is not None)
    if len(points) > 2 * THINNED_POINTS and sized:
        densities.insert(0, _thinned(points, rng))
    best: Face | None = None
    refusal: Refused | None = None
    seen, beaten = 0, -np.inf
    for seen, plane in enumerate(find_planes(some.stacked(), rng), start=1):
        if seen == 1 and plane.sigma_mm > MAX_NOISE_MM:
            raise Refused("too_noisy", f"the largest plane scatters by {plane.sigma_mm:.2f} mm")
        try:
            face = _try_plane(densities, plane, part, eye, reference)
        except _Ambiguous as error:
            refusal, beaten = refusal or error, max(beaten, error.score + 0.1 * part.count)
            continue
        except Refused as error:
            refusal = refusal or error
            continue
        # planes come largest first: a smaller one must show the pattern plainly better
        if face is not None and face.pattern.score > beaten:
            best, beaten = face, face.pattern.score + 0.1 * part.count
        whole = best is not None and best.pattern.matched == part.count and best.pattern.score > 0.8 * part.count
        if whole or (best is not None and seen >= ENOUGH_PLANES):
            break
    if seen == 0:
        raise Refused("face_not_found", "no plane was found in the cloud")
    if best is None:
        raise refusal or Refused("features_missing", "no plane in view carries the nominal pattern")
    return best


def _thinned(points: Columns, rng: np.random.Generator) -> _Thinned:
    """Every so many-th row and column of a grid, or a random share of an unorganised cloud."""
    if points.pixels is None:
        chosen = np.flatnonzero(rng.random(len(points), dtype=np.float32) < 2.0 * THINNED_POINTS / len(points))
        return _Thinned(points.take(chosen), len(chosen) / len(points), 1.4 * CELLS_PER_SPACING)
    step = int(np.ceil(np.sqrt(len(points) / THINNED_POINTS)))
    height, width = points.shape
    starts = np.searchsorted(points.pixels, width * np.arange(height + 1))
    rows = np.concatenate([np.arange(starts[row], starts[row + 1]) for row in range(0, height, step)])
    chosen = rows[points.pixels[rows] % width % step == 0]
    return _Thinned(points.take(chosen), 1.0 / step**2, CELLS_PER_SPACING)


def _try_plane(densities: list[_Thinned], plane: Plane, part: Part, eye: Array | None, reference: Array) -> Face | None:
    """The plane with the pattern on it, None where no pattern shows.

    Where nobody knows the eye, the origin is tried first, as in a scanner's own frame; the points have the last word.
    """
    toward = plane.normal if plane.residuals(np.zeros(3) if eye is None else eye) > 0.0 else -plane.normal
    if eye is not None:
        return _try_side(densities, plane, toward, part, reference)
    refusal: Refused | None = None
    unsure: Face | None = None
    for side in (toward, -toward):
        try:
            face = _try_side(densities, plane, side, part, reference)
        except Refused as error:
            refusal = refusal or error
            continue
        if face is None:
            continue
        front = np.inf if part.feature == "stud" else _seen_in_front(densities[0].points, face, part)
        if front > CLEAR_SIDE:
            return face
        unsure = unsure or (face if front > -CLEAR_SIDE else None)
    if unsure is not None and not before_the_eye(unsure.frame, np.zeros(3)):
        refusal, unsure = Refused("pattern_ambiguous", "nothing shows from which side the face was seen"), None
    if unsure is None and refusal is not None:
        raise refusal
    return unsure


def before_the_eye(frame: PlaneFrame, eye: Array) -> bool:
    """Whether a scanner at `eye` (3,) could look at the face of this frame: from well before it, not from aside."""
    u, v, height = frame.into(eye)
    return bool(height > LEAST_DISTANCE_MM and np.hypot(u, v) < height)


def _seen_in_front(points: Columns, face: Face, part: Part) -> float:
    """How surely what shows in the holes lies behind the face, in standard deviations; negative where it lies before.

    A hole shows its wall, its bottom or what stands behind the part; nothing of it stands before the face. Wrong
    depths fall on both sides alike, but neighbours are wrong together: a patch of half a radius has one vote, and the
    difference of the votes is a random walk.
    """
    deepest = max(part.depth_mm or 0.0, 3.0 * float(face.radii_mm.max()))
    local = points.into(face.frame)
    height = np.abs(local.z)
    off = np.flatnonzero((height > 6.0 * face.plane.sigma_mm) & (height < deepest))
    local = local.take(off[:: max(1, len(off) // SIDE_POINTS)])
    places = np.stack([local.x, local.y], axis=1)
    query = cKDTree(nominal(part)).query(places)
    inside = np.asarray(query[0]) < face.radii_mm[np.asarray(query[1])] + 0.5 * face.spacing_mm
    if not inside.any():
        return 0.0
    patches = np.floor(places[inside] / (0.5 * float(np.median(face.radii_mm)))).astype(np.intp)
    patches -= patches.min(axis=0)
    patch = patches[:, 0] * (patches[:, 1].max() + 1) + patches[:, 1]
    votes = np.sign(np.bincount(patch, np.where(local.z[inside] < 0.0, 1.0, -1.0)))
    return float(votes.sum()) / math.sqrt(max(int(np.count_nonzero(votes)), 1))


def _try_side(densities: list[_Thinned], plane: Plane, toward: Array, part: Part, reference: Array) -> Face | None:
    """The pattern on a plane seen from the side of `toward` (3,). Thinned points serve where they are fine enough."""
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
    voids = _holes(uv, part, space, thinned.cells) if part.feature == "hole" else _studs(local, uv, part, space)
    if len(voids) < 3:
        return None
    positions = np.stack([void.position_mm for void in voids])
    radii = np.array([void.radius_mm for void in voids])
    # chance voids are small: a large one weighs more, up to the usual size
    scores = np.array([void.score for void in voids]) * np.minimum(1.0, radii / np.quantile(radii, 0.75)) ** 2
    tolerance = max(0.006 * part.circle_diameter_mm, 2.0 * space)
    # where only sizes tell the clocking, walls tell it later: what the face shows of a size is torn and chamfered
    blind = blind_to_sizes(part)
    least = max(3, int(np.ceil(0.5 * part.count)))
    rivals = find_patterns(blind, positions, radii, scores, tolerance, within=max(1.0, RIVALS * part.count))
    rivals = [pattern for pattern in rivals if pattern.matched >= least]
    if part.feature == "hole" and (len(rivals) > 1 or any(pattern.matched < part.count for pattern in rivals)):
        edge = np.abs(local.z) < edge_band_mm(plane.sigma_mm, space)
        face = np.stack([local.x[edge], local.y[edge]], axis=1, dtype=np.float64)
        sizes = [_matched_radii(part, pose, positions, radii) for pose in rivals[:MOST_RIVALS]]
        judged = by_likeness(rivals[:MOST_RIVALS], face, part, np.stack(sizes), space) if rivals else []
        rivals = [pose for pose in judged if pose.score > LEAST_LIKENESS * part.count]
    if not rivals:
        return None
    if len(rivals) > 1 and rivals[1].score > rivals[0].score - CLEAR_MARGIN:
        raise _Ambiguous("two clockings of the pattern are met equally well", rivals[0].score)
    _refuse_two(part, rivals)
    _refuse_further(part, rivals[0], positions, radii, scores, tolerance)
    pattern = _nearest_to(rivals[0], frame, blind, reference)
    radii = _matched_radii(part, pattern, positions, radii)
    return Face(plane, _pattern_frame(frame, pattern), space * float(np.sqrt(thinned.share)), radii, pattern)


def _fine_enough(part: Part, cell_mm: float) -> bool:
    """Whether a raster with such cells shows the part's features: a hole's radius is 1.5 cells, a stud's two."""
    if part.feature == "stud":
        return 2.0 * cell_mm < (radius_of(part) or 0.0)
    return 1.5 * cell_mm < float(np.nanmin(void_radii(part)))


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
    cell = min(cells * space, max(float(radii.min()) / CELLS_PER_RADIUS, 0.5 * space))
    raster = rasterise(uv, cell, margin_mm=float(radii.max()))
    gap = max(2, int(np.ceil(0.9 * cells * space / cell)))
    return find_voids(raster, tuple(float(radius) for radius in radii), gap=gap)


def _studs(local: Columns, on_plane: Array, part: Part, space: float) -> list[Void]:
    """Ends of studs: discs of points at one height above the plane, whose points (N, 2) lie around them."""
    above = np.flatnonzero(local.z > LEAST_HEIGHT_MM)
    height = local.z[above].astype(np.float64)
    uv = np.stack([local.x[above], local.y[above]], axis=1, dtype=np.float64)
    most: list[Void] = []
    for level in tip_levels(height, part):
        tips = find_tips(uv, height, part, space, level)
        if len(tips) > len(most):
            most = max(most, standing(tips, on_plane, uv), key=len)
        if 2 * len(most) > part.count:
            break
    return most


def _refuse_two(part: Part, poses: list[PatternPose]) -> None:
    """Refuse (pattern_ambiguous) where the pattern stands in a second place as well: no score says which is meant."""
    for other in poses[1:]:
        aside = float(np.hypot(*(other.centre_mm - poses[0].centre_mm)))
        if aside > 0.5 * part.circle_diameter_mm and other.score > SECOND * part.count:
            raise _Ambiguous(f"the pattern is met in two places, {aside:.0f} mm apart", poses[0].score)


def _refuse_further(
    part: Part, pattern: PatternPose, positions: Array, radii: Array, scores: Array, tolerance_mm: float
) -> None:
    """Refuse (wrong_part) a circle that carries further features like those of the pattern between its places."""
    places = placed(part, pattern)
    distance = np.hypot(*(positions[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1)
    met = distance < tolerance_mm
    if not met.any():
        return
    size, score = np.median(radii[met]), np.median(scores[met])
    on = np.abs(np.hypot(*(positions - pattern.centre_mm).T) - 0.5 * part.circle_diameter_mm) < tolerance_mm
    alike = (np.abs(radii - size) < 0.2 * size) & (scores > 0.8 * score)
    further = int(np.count_nonzero(on & alike & (distance > tolerance_mm + size)))
    if further >= max(3.0, 0.4 * part.count):
        raise Refused("wrong_part", f"{further} further features stand on the circle of {part.count}")


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
    places = placed(part, pattern)
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
