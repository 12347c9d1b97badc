"""Type B covariance of the docking pose: every calibration value moved by one sigma, its effect at the docking height.

The levers come by themselves: a view's rotation acts at the distance of the part, the jack line's over the travel,
the table axis' over the turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cellctl.calibration import AxisLine, Calibration
from cellctl.docking.alignment import Station
from cellctl.docking.joint import Joint, offsets_at
from cellctl.kinematics import Array, AxesPosition, T_cell_table, rotation_about

_SEATED = Station(0.0)


def type_b(joint: Joint, calibration: Calibration, measured_at: AxesPosition, target: AxesPosition) -> Array:
    """(3, 3) covariance of (x mm, y mm, turn rad) of the shaft against the rotor, axes at `target`."""
    offsets, jacobian = offsets_at(joint, calibration, target, _SEATED)
    normal = np.einsum("iak,ial->kl", jacobian, jacobian)
    effects = [
        np.linalg.solve(normal, np.einsum("iak,ia->k", jacobian, moved - offsets))
        for moved in _worlds(joint, calibration, measured_at, target)
    ]
    stage = calibration.stage
    effects += list(np.diag([stage.sigma_position_mm, stage.sigma_position_mm, np.radians(stage.sigma_table_deg)]))
    straightness = calibration.jack_line.sigma_position_mm
    effects += list(np.diag([straightness, straightness, 0.0])[:2])
    rows = np.array(effects)
    return np.asarray(rows.T @ rows)


def _worlds(joint: Joint, calibration: Calibration, measured_at: AxesPosition, target: AxesPosition) -> Iterator[Array]:
    """Offsets (n, 2) at the same commanded target, with one calibration value off by one sigma each."""
    table = T_cell_table(calibration, measured_at)
    for view in ("rotor", "shaft"):
        for error in _view_errors(calibration, view):
            moved = _see_rotor(joint, error) if view == "rotor" else _see_shaft(joint, error, table)
            yield offsets_at(moved, calibration, target, _SEATED)[0]
    for other in _axis_errors(calibration):
        # The shaft was seen where it was; a wrong belief of the axes is undone at the scan and redone at the target.
        undo = np.linalg.inv(T_cell_table(other, measured_at)) @ table
        yield offsets_at(_move_shaft(joint, undo), other, target, _SEATED)[0]
    both = 1.0 + calibration.scanner.sigma_scale
    scaled = _move_shaft(_scale_rotor(joint, calibration, both), _scale_shaft(calibration, table, both))
    yield offsets_at(scaled, calibration, target, _SEATED)[0]


def _view_errors(calibration: Calibration, view: str) -> Iterator[Array]:
    """Rigid errors (4, 4) of one view, about the scanner: three turns, three shifts, two tilts by long-wave ripple."""
    belief = calibration.views["rotor" if view == "rotor" else "shaft"]
    scanner = belief.matrix[:3, 3]
    ripple = calibration.scanner.sigma_ripple_mm
    for axis in np.eye(3):
        yield _about(scanner, rotation_about(axis, np.radians(belief.sigma_rotation_deg)))
        shift = np.eye(4)
        shift[:3, 3] = axis * belief.sigma_translation_mm
        yield shift
    for axis in np.eye(3)[:2]:
        # Ripple of the depth that looks like a plane: along the rays it moves the part sideways by about a fifth.
        bent = np.eye(4)
        bent[:3, 3] = 0.2 * ripple * axis
        yield bent


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
