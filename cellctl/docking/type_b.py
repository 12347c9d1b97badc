"""Type B: every calibration value moved by one sigma, and what that does to the bolts at a station of the way in.

The levers come by themselves: a view's rotation acts at the distance of what touches there, the jack line's over the
travel so far, the table's over the turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from cellctl.calibration import AxisLine, Calibration
from cellctl.docking.alignment import Station
from cellctl.docking.joint import Joint, offsets_at
from cellctl.docking.ripple import rigid_motion, ripple_causes
from cellctl.kinematics import Array, AxesPosition, T_cell_table, rotation_about


def causes(
    joint: Joint,
    calibration: Calibration,
    measured_at: AxesPosition,
    target: AxesPosition,
    station: Station,
    shares: tuple[Array, Array] | None = None,
) -> Array:
    """(n, 2, k) change of each bolt's offset at `station` by one sigma of k independent causes, the shaft seated at
    `target`. At every station the causes are the same, column by column.

    `shares` (n,) of hole and stud: how much is kept of what each was seen off its place; all of it by default.
    """

    def offsets_of(seen: Joint, belief: Calibration = calibration) -> tuple[Array, Array]:
        return offsets_at(seen, belief, target, station)

    offsets, jacobian = offsets_of(joint)
    table = T_cell_table(calibration, measured_at)
    effects = [moved - offsets for moved in _worlds(joint, calibration, measured_at, offsets_of)]
    effects += list(np.einsum("iak,ck->cia", jacobian, _motions(calibration, measured_at, target)))
    whole = np.ones(len(offsets))
    waves = ripple_causes(joint, calibration, table, shares or (whole, whole), offsets_of)
    return np.concatenate([np.moveaxis(np.array(effects), 0, -1), waves], axis=2)


def rigid(effects: Array, jacobian: Array) -> Array:
    """(3, 3) covariance of the rigid motion (x mm, y mm, turn rad) that the causes (n, 2, k) amount to."""
    motions = rigid_motion(effects, jacobian)
    return np.asarray(motions @ motions.T)


def _motions(calibration: Calibration, measured_at: AxesPosition, target: AxesPosition) -> Array:
    """(c, 3) motions of the whole shaft (x mm, y mm, turn rad) by one sigma of each axis' own error.

    An eccentric encoder is off by a wave over the turn: between two angles a turn D apart by 2 sigma sin(D / 2) rms.
    """
    stage, jack = calibration.stage, calibration.jack_line
    turn = np.radians(target.theta_deg - measured_at.theta_deg)
    encoder = 2.0 * np.radians(stage.sigma_encoder_deg) * np.sin(0.5 * turn)
    angles = [np.radians(stage.sigma_table_deg), encoder, np.radians(jack.sigma_roll_deg)]
    shifts = [stage.sigma_position_mm, jack.sigma_position_mm]
    along_x, along_y, about = np.eye(3)
    return np.array([shift * axis for shift in shifts for axis in (along_x, along_y)] + [a * about for a in angles])


def _worlds(
    joint: Joint, calibration: Calibration, measured_at: AxesPosition, offsets_of: Callable[..., tuple[Array, Array]]
) -> Iterator[Array]:
    """Offsets (n, 2) at the same commanded target, with one calibration value off by one sigma each."""
    table = T_cell_table(calibration, measured_at)
    for view in ("rotor", "shaft"):
        for error in _view_errors(calibration, view):
            moved = _see_rotor(joint, error) if view == "rotor" else _see_shaft(joint, error, table)
            yield offsets_of(moved)[0]
    for other in _axis_errors(calibration):
        # The shaft was seen where it was; a wrong belief of the axes is undone at the scan and redone at the target.
        undo = np.linalg.inv(T_cell_table(other, measured_at)) @ table
        yield offsets_of(_move_shaft(joint, undo), other)[0]
    both = 1.0 + calibration.scanner.sigma_scale
    scaled = _move_shaft(_scale_rotor(joint, calibration, both), _scale_shaft(calibration, table, both))
    yield offsets_of(scaled)[0]


def _view_errors(calibration: Calibration, view: str) -> Iterator[Array]:
    """Rigid errors (4, 4) of one view: three turns about the scanner, three shifts."""
    belief = calibration.views["rotor" if view == "rotor" else "shaft"]
    scanner = belief.matrix[:3, 3]
    for axis in np.eye(3):
        yield _about(scanner, rotation_about(axis, np.radians(belief.sigma_rotation_deg)))
        shift = np.eye(4)
        shift[:3, 3] = axis * belief.sigma_translation_mm
        yield shift


def _axis_errors(calibration: Calibration) -> Iterator[Calibration]:
    """Calibrations with one direction or position of table axis or jack line off by one sigma."""
    for name in ("table_axis", "jack_line"):
        line: AxisLine = getattr(calibration, name)
        for axis in np.eye(3)[:2]:
            turned = rotation_about(axis, np.radians(line.sigma_direction_deg)) @ np.array(line.direction)
            yield _with(calibration, name, line.model_copy(update={"direction": tuple(turned)}))
        if name == "table_axis":
            for axis in np.eye(3)[:2]:
                point = np.array(line.point_mm) + line.sigma_position_mm * axis
                yield _with(calibration, name, line.model_copy(update={"point_mm": tuple(point)}))


def _with(calibration: Calibration, name: str, line: AxisLine) -> Calibration:
    return calibration.model_copy(update={name: line})


def _about(point: Array, rotation: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = point - rotation @ point
    return pose


def _see_rotor(joint: Joint, error: Array) -> Joint:
    turn, shift = error[:3, :3], error[:3, 3]
    face = np.stack([turn @ joint.rotor_face[0] + shift, turn @ joint.rotor_face[1]])
    return replace(joint, studs=joint.studs @ turn.T + shift, stud_axes=joint.stud_axes @ turn.T, rotor_face=face)


def _see_shaft(joint: Joint, error: Array, table: Array) -> Joint:
    return _move_shaft(joint, np.linalg.inv(table) @ error @ table)


def _move_shaft(joint: Joint, pose: Array) -> Joint:
    """The joint with everything of the shaft moved by `pose` (4, 4, maybe scaled) in the table's frame."""
    turn, shift = pose[:3, :3], pose[:3, 3]
    face = np.stack([turn @ joint.shaft_face[0] + shift, joint.shaft_face[1]])
    return replace(
        joint,
        holes=joint.holes @ turn.T + shift,
        hole_axes=joint.hole_axes @ turn.T,
        shaft_face=face,
        shaft_origin=turn @ joint.shaft_origin + shift,
    )


def _scale_rotor(joint: Joint, calibration: Calibration, scale: float) -> Joint:
    scanner = calibration.views["rotor"].matrix[:3, 3]
    return replace(joint, studs=scanner + scale * (joint.studs - scanner))


def _scale_shaft(calibration: Calibration, table: Array, scale: float) -> Array:
    scanner = calibration.views["shaft"].matrix[:3, 3]
    pose = np.diag([scale, scale, scale, 1.0])
    pose[:3, 3] = (1.0 - scale) * scanner
    return np.asarray(np.linalg.inv(table) @ pose @ table)
