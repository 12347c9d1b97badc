"""One cloud of one part, measured: the whole algorithm on one page.

cloud -> planes (eq. 14-18) -> the face, by its pattern -> face refitted -> holes (eq. 19-20) or studs (eq. 4-13)
      -> pattern -> pose with covariance (type A), or Refused and never a pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellctl.vision import outliers
from cellctl.vision.cloud import as_cloud
from cellctl.vision.columns import Columns
from cellctl.vision.contradictions import bare_places, check_absent, check_hole_sizes, check_outlines
from cellctl.vision.eye import viewpoint
from cellctl.vision.face import Face, before_the_eye, find_face
from cellctl.vision.flatness import inside_edges
from cellctl.vision.geometry import Array, PlaneFrame, Points, pose, transform, unit
from cellctl.vision.holes import Hole, Sight, measure_holes, reaches
from cellctl.vision.index import sizes_seen, turned_by_sizes
from cellctl.vision.part import FaceFit, FeatureFit, Part, PartMeasurement, Refused, pivot
from cellctl.vision.pattern import PatternFit, blind_to_sizes, symmetry
from cellctl.vision.placing import centres_on, check_known, place_pattern, well_seen
from cellctl.vision.plane import fit_face
from cellctl.vision.rays import regridded
from cellctl.vision.shared_noise import on_face as shared_noise
from cellctl.vision.studs import measure_studs
from cellctl.vision.walls import wall_radii
from cellctl.vision.zones import FACE, FEATURE, Zones


@dataclass(frozen=True, slots=True)
class Gates:
    """What a scan must have to be measured at all. Distances are along the view; None switches that gate off."""

    distance_low_mm: float | None = None
    distance_high_mm: float | None = None
    min_coverage: float = 0.3
    min_points_per_feature: int = 12
    outlier_removal: Literal["none", "one_sided", "two_sided"] = "none"


DEFAULT_GATES = Gates()
AREA_SAMPLE = 60_000
"""Points of a scan that are enough to tell how flat the face is."""
SCANNER_FLATNESS_MM = 0.1
"""How bent a scanner may show a flat face (VDI/VDE 2634-2): a part that meets its drawing is not refused for it."""
USUAL_DISTANCE_MM = 400.0
"""Of a structured-light scanner."""


def measure_part(
    points: Points, part: Part, T_frame_scanner: Array | None = None, *, gates: Gates = DEFAULT_GATES, seed: int = 0
) -> PartMeasurement:
    """Measure `part` in a cloud (H, W, 3) with NaN where invalid, or (N, 3), millimetres.

    With `T_frame_scanner` (4, 4) the result is in the cell frame, else in the cloud's own. `quality` holds coverage
    (share of the face seen), distance_mm (NaN where the scanner's place is not known), points, spacing_mm, found,
    min_points_per_feature, pattern_rms_mm, sigma_circle_mm (of the circle's diameter) and sigma_mm. Raises Refused
    with a code of `cellctl.vision.part`.
    """
    cloud = as_cloud(points)
    rng = np.random.default_rng(seed)
    grid: Points = cloud.points if cloud.organised else regridded(cloud.points, rng)
    if gates.outlier_removal != "none":
        grid = outliers.without_outliers(grid, sides=gates.outlier_removal)  # eq. 2-3
    scan = Columns.of(grid)
    pinhole = viewpoint(scan)
    eye = np.zeros(3) if pinhole is None and T_frame_scanner is not None else pinhole
    reference = np.array([1.0, 0.0, 0.0]) if T_frame_scanner is None else T_frame_scanner[0, :3]
    found = find_face(scan, part, eye, reference, rng)
    # Without rays or a pose nothing says where the scanner stood.
    seen_from = np.full(3, np.nan) if eye is None else eye
    eye = _likely_eye(found) if eye is None else eye
    if blind_to_sizes(part) is not part:
        found = _numbered(scan, found, part)
    seen = _sight(scan, found, part, pinhole, eye)
    face, frame = seen.face, seen.frame
    usable = well_seen(seen.features, gates.min_points_per_feature)
    fitted, features = place_pattern(usable, frame, part)
    if part.feature == "hole":
        check_hole_sizes(part, seen.walls_mm, face.sigma_mm)
        check_outlines(part, features)
    lost = frozenset(feature.index for feature in features if not feature.found)
    bare = bare_places(part, lost, scan, frame, found.radii_mm, face.sigma_mm, found.spacing_mm)
    check_absent(part, bare, usable, features, fitted)
    check_known(fitted, found.spacing_mm, face.sigma_mm)
    quality = _quality(scan, seen.places, face, frame, found, features, fitted, seen_from)
    _check(quality, features, part, gates)
    return _assemble(features, face, frame, fitted, part, quality, T_frame_scanner)


@dataclass(frozen=True, slots=True)
class _Places:
    """Points in the part's approximate frame: on the face's own area near its plane, around holes with the hole of
    each (`owner`), and a sample of those well inside the face's own area, at any height."""

    on_face: Columns
    around: Columns
    owner: NDArray[np.intp]
    area: Columns
    coverage: float

    def around_in(self, found: PlaneFrame, frame: PlaneFrame) -> Columns:
        """The points around holes in the coordinates of `frame`; those at hand are in the frame that was found."""
        return self.around.into(PlaneFrame(found.into(frame.origin), frame.axes @ found.axes.T))


@dataclass(frozen=True, slots=True)
class _Sighting:
    """Face and features as measured, with the frame of the face; radii (n,) of the holes' walls, NaN where unseen."""

    places: _Places
    face: FaceFit
    frame: PlaneFrame
    features: tuple[FeatureFit, ...]
    walls_mm: Array


def _numbered(scan: Columns, found: Face, part: Part) -> Face:
    """The face with its holes numbered by their sizes, where their places leave the number open."""
    places = _place(scan, found, part)
    return turned_by_sizes(found, sizes_seen(places.around, places.owner, found, part), part)


def _sight(scan: Columns, found: Face, part: Part, pinhole: Array | None, eye: Array) -> _Sighting:
    """The face refitted, then every feature on it."""
    places = _place(scan, found, part)
    face = _refit_face(places, found, part)
    frame = PlaneFrame.on(_onto(face, found.frame.origin), face.normal, found.frame.axes[0])
    if part.feature == "stud":
        features = measure_studs(scan, face, part, pose(frame.axes.T, frame.origin), viewpoint=eye)
        return _Sighting(places, face, frame, features, np.full(part.count, np.nan))
    near = places.around_in(found.frame, frame)
    features = _holes(near, places, face, frame, found, part, pinhole)
    walls = wall_radii(near, places.owner, centres_on(features, frame, part), part)
    return _Sighting(places, face, frame, features, walls)


def _place(scan: Columns, found: Face, part: Part) -> _Places:
    """One look at every point: where on the part it is."""
    reach = reaches(part, found.radii_mm) if part.feature == "hole" else found.radii_mm
    zones = Zones.of(part, found.radii_mm, reach, found.spacing_mm)
    codes = zones.codes.reshape(-1)
    near, level = 8.0 * found.plane.sigma_mm + (part.flatness_limit_mm or 0.0), 5.0 * found.plane.sigma_mm + 0.01
    on_face, around, owner, area, seen = [], [], [], [], np.zeros(len(codes), dtype=np.bool_)
    step = max(1, len(scan) // AREA_SAMPLE)
    for _, piece in scan.batches():
        local = piece.into(found.frame)
        cells = zones.cells(local.x, local.y)
        code, height = codes.take(cells), np.abs(local.z)
        rows = np.flatnonzero((code >= FACE) & (height < near))
        on_face.append(local.take(rows))
        some = local.take(np.flatnonzero(code[::step] >= FACE) * step)
        area.append(some.take(inside_edges(some, part, found.radii_mm)))
        seen[cells[rows[height[rows] < level]]] = True
        if part.feature == "hole":
            code &= FEATURE
            rows = np.flatnonzero(code != 0)
            around.append(local.take(rows))
            owner.append(code[rows].astype(np.intp) - 1)
    whole = [Columns.joined(parts, scan) for parts in (on_face, around, area)]
    owners = np.concatenate(owner) if owner else np.zeros(0, dtype=np.intp)
    return _Places(whole[0], whole[1], owners, whole[2], zones.coverage(seen))


def _likely_eye(found: Face) -> Array:
    """Where the scanner of a list of points may have stood: at the origin where that could see the face."""
    if before_the_eye(found.frame, np.zeros(3)):
        return np.zeros(3)
    return found.frame.out(np.array([0.0, 0.0, USUAL_DISTANCE_MM]))


def _onto(face: FaceFit, point: Array) -> Array:
    """Foot of `point` on the face plane."""
    return np.asarray(point - ((point - face.point_mm) @ face.normal) * face.normal)


def _refit_face(places: _Places, found: Face, part: Part) -> FaceFit:
    """The face plane from the face alone: inside its rims and clear of the features, whose edges would pull it."""
    face = fit_face(places.on_face, found.frame, found.plane.sigma_mm, places.area)
    if part.flatness_limit_mm is not None and face.flatness_mm > part.flatness_limit_mm + SCANNER_FLATNESS_MM:
        raise Refused(
            "face_warped",
            f"the face is {face.flatness_mm:.3f} mm out of flat, the recipe allows {part.flatness_limit_mm:g} mm",
        )
    return face


def _holes(
    near: Columns, places: _Places, face: FaceFit, frame: PlaneFrame, found: Face, part: Part, pinhole: Array | None,
) -> tuple[FeatureFit, ...]:  # fmt: skip
    """Every hole of the part, in the cloud's frame; `near` are the points around them in the frame of the face."""
    sight = Sight(found.spacing_mm, face.sigma_mm)
    if pinhole is not None:
        height = float(face.normal @ (face.point_mm - found.frame.origin))
        noise = shared_noise(places.on_face, found.frame.axes @ face.normal, height, face.sigma_mm)
        sight = Sight(found.spacing_mm, face.sigma_mm, frame.into(pinhole), noise)
    holes = measure_holes(near, places.owner, part, found.radii_mm, sight)
    return tuple(_feature(index, hole, frame, face) for index, hole in enumerate(holes))


def _feature(index: int, hole: Hole, frame: PlaneFrame, face: FaceFit) -> FeatureFit:
    """A hole out of the face's coordinates. Its centre lies on the face, so the face's height joins its covariance."""
    if not hole.found:
        return FeatureFit(index=index, found=False, reason=hole.reason)
    centre = frame.out(np.append(hole.centre_mm, 0.0))
    arm = face.tilt_axes @ (centre - face.point_mm)
    lever = np.array([1.0, arm[1], -arm[0]])
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = hole.covariance[:2, :2]
    covariance[2, 2] = lever @ face.covariance @ lever
    return FeatureFit(
        index=index,
        found=True,
        center_mm=centre,
        axis=unit(frame.axes.T @ np.append(hole.slopes, 1.0)),
        radius_mm=hole.radius_mm,
        covariance_mm2=frame.axes.T @ covariance @ frame.axes,
        axis_sigma_deg=float(np.degrees(np.sqrt(np.trace(hole.covariance[2:, 2:]) / 2.0))),
        pivot_mm=pivot(hole.covariance),
        points=hole.points,
        residual_mm=hole.residual_mm,
        chamfer_radius_mm=hole.chamfer_radius_mm,
    )


def _quality(
    scan: Columns, places: _Places, face: FaceFit, frame: PlaneFrame, found: Face, features: tuple[FeatureFit, ...],
    fitted: PatternFit, eye: Array,
) -> dict[str, float]:  # fmt: skip
    carried = [feature.points for feature in features if feature.found]
    return {
        "coverage": places.coverage,
        "distance_mm": float(abs(frame.into(eye)[2])),
        "points": float(len(scan)),
        "spacing_mm": found.spacing_mm,
        "sigma_mm": face.sigma_mm,
        "found": float(len(carried)),
        "min_points_per_feature": float(min(carried, default=0)),
        "pattern_rms_mm": float(np.sqrt(np.nanmean(fitted.residuals_mm**2))),
        "sigma_circle_mm": fitted.sigma_diameter_mm,
        "matched": float(found.pattern.matched),
    }


def _check(quality: dict[str, float], features: tuple[FeatureFit, ...], part: Part, gates: Gates) -> None:
    """The quality gates: a poor scan never becomes a pose. Raises Refused."""
    distance = quality["distance_mm"]
    low, high = gates.distance_low_mm, gates.distance_high_mm
    if (low is not None and distance < low) or (high is not None and distance > high):
        raise Refused("out_of_range", f"the face is {distance:.0f} mm away, {low} to {high} mm are allowed")
    if quality["coverage"] < gates.min_coverage:
        raise Refused(
            "too_few_points",
            f"{100 * quality['coverage']:.0f} % of the face seen, {100 * gates.min_coverage:.0f} needed",
        )
    found = sum(feature.found for feature in features)
    if found < max(3, (part.count + 1) // 2):
        raise Refused("features_missing", f"{found} of {part.count} features found")


def _assemble(
    features: tuple[FeatureFit, ...], face: FaceFit, frame: PlaneFrame, fitted: PatternFit, part: Part,
    quality: dict[str, float], T_frame_scanner: Array | None,
) -> PartMeasurement:  # fmt: skip
    """Pose of the part from face and pattern, its covariance in the part frame, everything carried into the frame."""
    c, s = np.cos(fitted.clocking_rad), np.sin(fitted.clocking_rad)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ frame.axes
    origin = frame.out(np.append(fitted.centre_mm, 0.0))
    # type A: x, y, rz from the pattern, turned into the part frame; z, rx, ry from the face at the pattern's centre
    covariance = np.zeros((6, 6))
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = turn @ fitted.covariance @ turn.T
    arm = face.tilt_axes @ (origin - face.point_mm)
    tilts = axes[:2] @ face.tilt_axes.T
    carry = np.vstack([[1.0, arm[1], -arm[0]], np.column_stack([np.zeros(2), tilts])])
    covariance[np.ix_([2, 3, 4], [2, 3, 4])] = carry @ face.covariance @ carry.T
    T = np.eye(4) if T_frame_scanner is None else T_frame_scanner
    return PartMeasurement(
        frame="input" if T_frame_scanner is None else "cell",
        feature=part.feature,
        face=_carry_face(face, T),
        T_frame_part=T @ pose(axes.T, origin),
        covariance=covariance,
        sigma_clocking_deg=float(np.degrees(np.sqrt(fitted.covariance[2, 2]))),
        clocking_free=symmetry(part) > 1,
        features=tuple(_carry_feature(feature, T) for feature in features),
        circle_diameter_mm=fitted.diameter_mm,
        quality=quality,
    )


def _carry_face(face: FaceFit, T: Array) -> FaceFit:
    rotation = T[:3, :3]
    return FaceFit(
        transform(T, face.point_mm), rotation @ face.normal, face.tilt_axes @ rotation.T, face.covariance,
        face.sigma_mm, face.flatness_mm, face.points, face.inliers,
    )  # fmt: skip


def _carry_feature(feature: FeatureFit, T: Array) -> FeatureFit:
    if feature.center_mm is None or feature.axis is None or feature.covariance_mm2 is None:
        return feature
    rotation = T[:3, :3]
    return replace(
        feature,
        center_mm=transform(T, feature.center_mm),
        axis=rotation @ feature.axis,
        covariance_mm2=rotation @ feature.covariance_mm2 @ rotation.T,
    )
