"""The two measured sides as one joint: holes that move with the axes, studs that stand. Pure geometry, cell frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cellctl.calibration import Calibration
from cellctl.docking.alignment import Station
from cellctl.kinematics import Array, AxesPosition, T_cell_table
from cellctl.vision.part import FeatureFit, PartMeasurement


@dataclass(frozen=True, slots=True)
class Joint:
    """Holes in the table's frame (they turn and travel), studs in the cell. Row i of both belongs to bolt i.

    `holes`, `hole_axes`, `studs`, `stud_axes` (n, 3); `shaft_face`, `rotor_face` (2, 3) point and outward normal;
    `shaft_origin` (3,) the pattern's centre; `variance_mm2` (n,) per axis of hole minus stud; `*_lean_rad` (n,) one
    sigma of the axes' direction.
    """

    holes: Array
    hole_axes: Array
    shaft_face: Array
    shaft_origin: Array
    studs: Array
    stud_axes: Array
    rotor_face: Array
    variance_mm2: Array
    hole_lean_rad: Array
    stud_lean_rad: Array
    partner: tuple[int, ...]


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
    holes, hole_axes, hole_var, hole_lean = _lines(shaft.features, shaft.face.normal)
    studs, stud_axes, stud_var, stud_lean = _lines(rotor.features, rotor.face.normal)
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
            variance_mm2=hole_var + stud_var[k],
            hole_lean_rad=hole_lean,
            stud_lean_rad=stud_lean[k],
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


def arms_at(joint: Joint, calibration: Calibration, at: AxesPosition) -> Array:
    """(n, 2) from the shaft's pattern centre to each hole, across the travel."""
    pose = T_cell_table(calibration, at)
    return np.asarray((joint.holes - joint.shaft_origin) @ pose[:3, :3].T @ basis_of(calibration)[:2].T)


def _lines(features: tuple[FeatureFit, ...], normal: Array) -> tuple[Array, Array, Array, Array]:
    """Centres and axes (n, 3) along `normal`, variance (n,) across it per axis, one sigma (n,) of direction in rad."""
    centres, axes, variances, leans = [], [], [], []
    across = np.eye(3) - np.outer(normal, normal)
    for feature in features:
        assert feature.center_mm is not None and feature.covariance_mm2 is not None
        axis = normal if feature.axis is None else feature.axis * np.sign(feature.axis @ normal)
        centres.append(feature.center_mm)
        axes.append(axis)
        variances.append(0.5 * float(np.trace(across @ feature.covariance_mm2 @ across)))
        leans.append(np.radians(feature.axis_sigma_deg or 0.0))
    return np.array(centres), np.array(axes), np.array(variances), np.array(leans)


def _apply(pose: Array, points: Array) -> Array:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])
