"""The two measured sides as one joint: holes that move with the axes, studs that stand. Pure geometry, cell frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import Calibration
from cellctl.docking.alignment import Station
from cellctl.kinematics import Array, AxesPosition, T_cell_table
from cellctl.vision.part import FeatureFit, PartMeasurement


@dataclass(frozen=True, slots=True)
class Spread:
    """How well the axes of n features are known, type A, per axis across the face and independent between features.

    `place_mm2` (n,) variance of an axis' place at the height `pivot_mm` (n,) above the face; `lean_rad` (n,) one sigma
    of its direction, independent of that place; `radius_mm` (n,) how wide the feature is.
    """

    place_mm2: Array
    pivot_mm: Array
    lean_rad: Array
    radius_mm: Array

    def lever_mm(self, height_mm: float) -> Array:
        """(n,) what one sigma of the lean moves at that height above the face, signed."""
        return np.asarray((height_mm - self.pivot_mm) * self.lean_rad)

    def take(self, rows: NDArray[np.intp]) -> Spread:
        """The features of some rows."""
        return Spread(self.place_mm2[rows], self.pivot_mm[rows], self.lean_rad[rows], self.radius_mm[rows])


@dataclass(frozen=True, slots=True)
class Joint:
    """Holes in the table's frame (they turn and travel), studs in the cell. Row i of both belongs to bolt i.

    `holes`, `hole_axes`, `studs`, `stud_axes` (n, 3); `shaft_face`, `rotor_face` (2, 3) point and outward normal;
    `shaft_origin` (3,) the pattern's centre; `hole_spread`, `stud_spread` how well the axes are known.
    """

    holes: Array
    hole_axes: Array
    shaft_face: Array
    shaft_origin: Array
    studs: Array
    stud_axes: Array
    rotor_face: Array
    hole_spread: Spread
    stud_spread: Spread
    partner: tuple[int, ...]

    @property
    def variance_mm2(self) -> Array:
        """(n,) per axis of hole minus stud, both at their faces."""
        return np.asarray(np.sum(own_errors(self, Station(0.0)) ** 2, axis=1))


def joint_of(
    rotor: PartMeasurement,
    shaft: PartMeasurement,
    partner: tuple[int, ...],
    calibration: Calibration,
    measured_at: AxesPosition,
) -> Joint:
    """Joint of two measurements in the cell frame; `partner[i]` is the rotor's feature that the shaft's i meets."""
    return next(joints_of(rotor, shaft, (partner,), calibration, measured_at))


def joints_of(
    rotor: PartMeasurement,
    shaft: PartMeasurement,
    partners: tuple[tuple[int, ...], ...],
    calibration: Calibration,
    measured_at: AxesPosition,
) -> Iterator[Joint]:
    """One `Joint` for each pairing."""
    inverse = np.asarray(np.linalg.inv(T_cell_table(calibration, measured_at)), dtype=np.float64)
    holes, hole_axes, hole_spread = _lines(shaft.features, shaft.face.normal)
    studs, stud_axes, stud_spread = _lines(rotor.features, rotor.face.normal)
    turn = inverse[:3, :3]
    for partner in partners:
        k = np.array(partner, dtype=np.intp)
        yield Joint(
            holes=_apply(inverse, holes),
            hole_axes=hole_axes @ turn.T,
            shaft_face=np.stack([_apply(inverse, shaft.face.point_mm[None])[0], turn @ shaft.face.normal]),
            shaft_origin=_apply(inverse, shaft.T_frame_part[None, :3, 3])[0],
            studs=studs[k],
            stud_axes=stud_axes[k],
            rotor_face=np.stack([rotor.face.point_mm, rotor.face.normal]),
            hole_spread=hole_spread,
            stud_spread=stud_spread.take(k),
            partner=partner,
        )


def basis_of(calibration: Calibration) -> Array:
    """(3, 3): rows e1, e2 across the jack's travel (e1 nearest the cell's x) and u along it."""
    u = np.array(calibration.jack_line.direction) / np.linalg.norm(calibration.jack_line.direction)
    e1 = np.array([1.0, 0.0, 0.0]) - u[0] * u
    e1 /= np.linalg.norm(e1)
    return np.stack([e1, np.cross(u, e1), u])


def pivot_at(calibration: Calibration, at: AxesPosition) -> Array:
    """(3,) point of the table axis in the cell: what the shaft turns about."""
    point = np.array([*calibration.table_axis.point_mm, 1.0])
    return np.asarray((T_cell_table(calibration, at) @ point)[:3])


def holes_at(joint: Joint, calibration: Calibration, at: AxesPosition) -> tuple[Array, Array]:
    """Hole centres on the shaft's face and outward hole axes (n, 3) in the cell."""
    pose = T_cell_table(calibration, at)
    return _apply(pose, joint.holes), joint.hole_axes @ pose[:3, :3].T


def shaft_face_at(joint: Joint, calibration: Calibration, at: AxesPosition) -> tuple[Array, Array]:
    """Point and outward normal of the shaft's face in the cell."""
    pose = T_cell_table(calibration, at)
    return _apply(pose, joint.shaft_face[:1])[0], np.asarray(pose[:3, :3] @ joint.shaft_face[1])


def seat(joint: Joint, calibration: Calibration, at: AxesPosition, rim_radius_mm: float) -> AxesPosition:
    """`at` with the jack where the faces first touch on a rim of that radius about the shaft's pattern."""
    u = basis_of(calibration)[2]
    pose = T_cell_table(calibration, at)
    point, normal = shaft_face_at(joint, calibration, at)
    centre = _apply(pose, joint.shaft_origin[None])[0]
    centre = centre - ((centre - point) @ normal) / (u @ normal) * u
    rotor_point, rotor_normal = joint.rotor_face
    gap = (rotor_point - centre) @ rotor_normal / (u @ rotor_normal)
    wedge = float(np.linalg.norm(np.cross(normal, -rotor_normal)))
    return replace(at, z_mm=at.z_mm + float(gap) - rim_radius_mm * wedge)


def offsets_at(joint: Joint, calibration: Calibration, seated: AxesPosition, station: Station) -> tuple[Array, Array]:
    """Offsets (n, 2) hole minus stud at a station of the way in; their jacobian (n, 2, 3) to x, y (mm), turn (rad)."""
    basis = basis_of(calibration)
    u = basis[2]
    at = replace(seated, z_mm=seated.z_mm - station.gap_mm)
    holes, axes = holes_at(joint, calibration, at)
    places = holes - station.depth_mm * axes
    along = ((places - joint.studs) @ u) / (joint.stud_axes @ u)
    studs = joint.studs + along[:, None] * joint.stud_axes
    arms = (places - pivot_at(calibration, at)) @ basis[:2].T
    jacobian = np.zeros((len(arms), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -arms[:, 1], arms[:, 0]
    return (places - studs) @ basis[:2].T, jacobian


def lags_at(joint: Joint, calibration: Calibration, seated: AxesPosition) -> Array:
    """(n,) by how much more travel than the first each bolt needs, because the faces are not parallel."""
    u = basis_of(calibration)[2]
    gaps = ((holes_at(joint, calibration, seated)[0] - joint.studs) @ u) / (joint.stud_axes @ u)
    return np.asarray(gaps - gaps.min())


def arms_at(joint: Joint, calibration: Calibration, at: AxesPosition) -> Array:
    """(n, 2) from the shaft's pattern centre to each hole, across the travel."""
    pose = T_cell_table(calibration, at)
    return np.asarray((joint.holes - joint.shaft_origin) @ pose[:3, :3].T @ basis_of(calibration)[:2].T)


def own_errors(joint: Joint, station: Station) -> Array:
    """(n, 3) one sigma per axis of what each bolt's offset is wrong by for itself: places, lean of stud, lean of hole.

    Column by column the same error at every station of the way in.
    """
    places = np.sqrt(joint.hole_spread.place_mm2 + joint.stud_spread.place_mm2)
    stud = joint.stud_spread.lever_mm(station.gap_mm + station.depth_mm)
    return np.column_stack([places, stud, joint.hole_spread.lever_mm(-station.depth_mm)])


def _lines(features: tuple[FeatureFit, ...], normal: Array) -> tuple[Array, Array, Spread]:
    """Centres and axes (n, 3), these along `normal`, and how well both are known across it."""
    centres, axes, places, pivots, leans, radii = [], [], [], [], [], []
    across = np.eye(3) - np.outer(normal, normal)
    for feature in features:
        assert feature.center_mm is not None and feature.covariance_mm2 is not None
        lean = np.radians(feature.axis_sigma_deg or 0.0)
        face = 0.5 * float(np.trace(across @ feature.covariance_mm2 @ across))
        centres.append(feature.center_mm)
        axes.append(normal if feature.axis is None else feature.axis * np.sign(feature.axis @ normal))
        places.append(max(face - (feature.pivot_mm * lean) ** 2, 0.0))
        pivots.append(feature.pivot_mm)
        leans.append(lean)
        radii.append(feature.radius_mm or 0.0)
    spread = Spread(np.array(places), np.array(pivots), np.array(leans), np.array(radii))
    return np.array(centres), np.array(axes), spread


def _apply(pose: Array, points: Array) -> Array:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])
