"""A twin that is as the calibration says: for a dry run, in which the controller's belief must be the truth."""

from __future__ import annotations

import numpy as np

from cellctl.calibration import Calibration
from hal.fake.frames import Array
from hal.fake.geometry import BenchGeometry


def numbers_of(calibration: Calibration) -> dict[str, float]:
    """Numbers of the twin (`hal.fake.levels.Properties`) that make its bench the believed one."""
    bench = BenchGeometry()
    numbers: dict[str, float] = {}
    for view, drawn in (("rotor", bench.T_cell_camera_rotor), ("shaft", bench.T_cell_camera_shaft)):
        off = np.linalg.inv(drawn) @ calibration.views["rotor" if view == "rotor" else "shaft"].matrix
        names = [f"camera_{view}_shift_{axis}_mm" for axis in "xyz"]
        names += [f"camera_{view}_rotation{about}_deg" for about in ("_x", "_y", "")]
        numbers |= dict(zip(names, [*off[:3, 3], *np.degrees(_turns(off))], strict=True))
    axis, stage, force = calibration.table_axis, calibration.stage, calibration.jack_force
    jack = np.array(calibration.jack_line.direction)
    lean = np.array(axis.direction) / np.linalg.norm(axis.direction)
    foot = np.array(axis.point_mm) - lean * axis.point_mm[2] / lean[2]
    x, y = stage.x_direction, stage.y_direction
    numbers |= {
        "table_axis_shift_x_mm": foot[0],
        "table_axis_shift_y_mm": foot[1],
        "table_axis_tilt_x_deg": np.degrees(-np.arcsin(lean[1])),
        "table_axis_tilt_y_deg": np.degrees(np.arctan2(lean[0], lean[2])),
        "jack_line_tilt_x_deg": np.degrees(np.arctan2(jack[0], jack[2])),
        "jack_line_tilt_y_deg": np.degrees(np.arctan2(jack[1], jack[2])),
        "stage_x_turn_deg": np.degrees(np.arctan2(x[1], x[0])),
        "stage_y_turn_deg": np.degrees(np.arctan2(-y[0], y[1])),
        "force_gain": 1.0 / force.gain,
        "force_offset_n": force.offset_n,
    }
    return {name: float(value) for name, value in numbers.items()}


def _turns(pose: Array) -> tuple[float, float, float]:
    """Radians about x, y, z, applied x first (`hal.fake.frames.small_pose`)."""
    r = pose[:3, :3]
    return float(np.arctan2(r[2, 1], r[2, 2])), float(-np.arcsin(r[2, 0])), float(np.arctan2(r[1, 0], r[0, 0]))
