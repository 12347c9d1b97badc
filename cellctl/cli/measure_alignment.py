"""Where the shaft would have to go, for two parts measured from files: axes at 0, calibration given or none."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from cellctl.calibration import Artefact, AxisLine, Calibration, ViewCalibration
from cellctl.docking import Alignment, align, align_spec
from cellctl.kinematics import AxesPosition
from cellctl.recipe import Recipe
from cellctl.vision.geometry import Array, tangents
from cellctl.vision.part import PartMeasurement, Refused

AT_HOME = AxesPosition(0.0, 0.0, 0.0, 0.0)
UPRIGHT_DEG = 2.0
NEAR_AXIS_MM = 20.0
IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def alignment_document(
    rotor: PartMeasurement, shaft: PartMeasurement, recipe: Recipe, calibration: Calibration | None
) -> dict[str, Any]:
    """The `alignment` of the document: what the axes, standing at 0, would have to do. Raises Refused.

    Without a calibration the input is taken for the cell frame where the shaft looks along its z, else the axes are
    those that the shaft itself shows: travel along its normal, turn about its pattern's centre.
    """
    if float(rotor.face.normal @ shaft.face.normal) > -0.9:
        raise Refused("frames_disagree", "the two faces do not look at each other: give the calibration of both views")
    if calibration is None:
        calibration = _as_found(shaft)
        rotor, shaft = replace(rotor, frame="cell"), replace(shaft, frame="cell")
    return _document(align(rotor, shaft, calibration, AT_HOME, align_spec(recipe)))


def _document(found: Alignment) -> dict[str, Any]:
    return {
        "theta_deg": found.theta_deg,
        "x_mm": found.x_mm,
        "y_mm": found.y_mm,
        "tilt_deg": found.tilt_deg,
        "gap_mm": found.gap_mm,
        "sigma_theta_deg": found.sigma_theta_deg,
        "sigma_xy_mm": found.sigma_xy_mm,
        "p_insert": found.p_insert,
        "predicted_peak_force_n": found.predicted_peak_force_n,
        "clearance_mm": np.asarray(found.clearance_mm).tolist(),
        "clearance_hot_mm": np.asarray(found.clearance_hot_mm).tolist(),
        "eps_pla": found.eps_pla,
        "eps_cyc": found.eps_cyc,
        "clocking_free": found.clocking_free,
    }


def _as_found(shaft: PartMeasurement) -> Calibration:
    """Ideal axes in the frame of the clouds."""
    normal, point = shaft.face.normal, shaft.T_frame_part[:3, 3]
    if normal[2] > np.cos(np.radians(UPRIGHT_DEG)) and np.hypot(point[0], point[1]) < NEAR_AXIS_MM:
        normal, point = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    across = tangents(normal)
    line = AxisLine(point_mm=_triple(point), direction=_triple(normal))
    corners = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0))
    view = ViewCalibration(T_cell_scanner=IDENTITY, sigma_rotation_deg=0.0, sigma_translation_mm=0.0)
    return Calibration.model_validate(
        {
            "id": "as-found",
            "valid_from": datetime(2000, 1, 1, tzinfo=UTC),
            "valid_until": datetime(2100, 1, 1, tzinfo=UTC),
            "views": {"rotor": view, "shaft": view},
            "table_axis": line,
            "jack_line": line,
            "stage": {"x_direction": _triple(across[0]), "y_direction": _triple(across[1])},
            "artefact": Artefact(sphere_diameter_mm=1.0, rotor_side_mm=corners, shaft_side_mm=corners),
        }
    )


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z
