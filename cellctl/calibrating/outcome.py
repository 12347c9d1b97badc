"""What a procedure found as a part of the calibration file, and in numbers for people. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellctl.calibrating.camera import ViewPose
from cellctl.calibrating.entry import Part
from cellctl.calibrating.force import Force
from cellctl.calibrating.jack import JackLine
from cellctl.calibrating.stage import StageAxes
from cellctl.calibrating.table import TableAxis
from cellctl.calibration import AxisLine, Calibration, ForceGain, ViewCalibration
from cellctl.steps.scan import Side
from cellctl.vision.geometry import Array


def of_camera(base: Calibration, found: Mapping[Side, ViewPose], looks: int) -> Part:
    """Both views."""
    views = {}
    figures: dict[str, float] = {}
    for side, pose in found.items():
        views[side] = ViewCalibration(
            T_cell_scanner=_rows(pose.T_cell_scanner),
            sigma_rotation_deg=pose.sigma_rotation_deg,
            sigma_translation_mm=pose.sigma_translation_mm,
            covariance=_rows(pose.covariance),
        )
        was = base.views[side].matrix
        cosine = 0.5 * (np.trace(was[:3, :3].T @ pose.T_cell_scanner[:3, :3]) - 1.0)
        figures |= {
            f"{side}_residual_rms_mm": float(np.sqrt(np.mean(pose.residual_mm**2))),
            f"{side}_residual_max_mm": float(pose.residual_mm.max()),
            f"{side}_noise_mm": pose.noise_mm,
            f"{side}_moved_mm": float(np.linalg.norm(pose.T_cell_scanner[:3, 3] - was[:3, 3])),
            f"{side}_turned_deg": float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))),
        }
    return Part("camera", {"views": {**base.views, **views}}, looks * len(found), figures)


def of_axes(base: Calibration, table: TableAxis, stage: StageAxes, jack: JackLine, stops: int) -> Part:
    """Table axis, stage and jack line."""
    place, lean = (
        float(np.sqrt(0.5 * np.trace(block))) for block in (table.covariance[:2, :2], table.covariance[2:, 2:])
    )
    whole = np.zeros((4, 4))
    whole[2:, 2:] = jack.covariance
    sections = {
        "table_axis": AxisLine(
            point_mm=_row(table.point_mm),
            direction=_row(table.direction),
            sigma_direction_deg=lean,
            sigma_position_mm=place,
            covariance=_rows(table.covariance),
        ),
        "stage": base.stage.model_copy(
            update={
                "x_direction": _row(stage.x_direction),
                "y_direction": _row(stage.y_direction),
                "sigma_direction_deg": stage.sigma_direction_deg,
                "sigma_position_mm": stage.residual_mm,
                "sigma_encoder_deg": table.encoder_deg,
            }
        ),
        "jack_line": base.jack_line.model_copy(
            update={
                "direction": _row(jack.direction),
                "sigma_direction_deg": float(np.sqrt(0.5 * np.trace(jack.covariance))),
                "sigma_position_mm": jack.straightness_mm,
                "covariance": _rows(whole),
            }
        ),
    }
    figures = {
        "table_residual_mm": table.residual_mm,
        "table_residual_deg": table.residual_deg,
        "table_angle_residual_deg": table.angle_deg,
        "stage_residual_mm": stage.residual_mm,
        "stage_out_of_square_deg": stage.square_deg,
        "jack_straightness_mm": jack.straightness_mm,
        "probe_residual_mm": jack.residual_mm,
    }
    return Part("axes", sections, stops, figures)


def of_force(found: Force, weights: int) -> Part:
    """The jack's force sensor."""
    sigma = np.sqrt(np.diag(found.covariance))
    gain = ForceGain(
        gain=found.gain,
        sigma_gain=float(sigma[0]),
        offset_n=found.offset_n,
        sigma_offset_n=float(sigma[1]),
        linearity=found.linearity,
    )
    figures = {"noise_n": found.noise_n, "friction_n": found.friction_n, "linearity": found.linearity}
    return Part("force", {"jack_force": gain}, weights, figures)


def _row(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _rows(matrix: Array) -> Any:
    return tuple(tuple(float(value) for value in row) for row in matrix)
