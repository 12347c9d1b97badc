"""Perturbed twins and their calibration, for tests and campaigns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellctl.calibrating.file import save_calibration
from cellctl.calibration import Calibration, Procedure, load_calibration
from cellctl.calibration_runner import CalibrationRequest, calibrate_once
from cellctl.recipe import Recipe
from hal.config import CalibrationEntry, CellConfig

ALL: tuple[Procedure, ...] = ("camera", "axes", "force")


def perturbations(generator: np.random.Generator) -> dict[str, float]:
    """Each view off by 0.5 mm and 0.1 degrees, the table's axis by 0.2 mm, the jack by 0.05 degrees, the force gain by
    10 %, in random directions; and a table that leans, a stage out of square, a force sensor with an offset."""
    found: dict[str, float] = {}
    for view in ("rotor", "shaft"):
        shift, turn = (_direction(generator) for _ in range(2))
        found |= {f"camera_{view}_shift_{axis}_mm": 0.5 * value for axis, value in zip("xyz", shift, strict=True)}
        names = (f"camera_{view}_rotation{about}_deg" for about in ("_x", "_y", ""))
        found |= {name: 0.1 * value for name, value in zip(names, turn, strict=True)}
    for name, size in (
        ("table_axis_shift_{}_mm", 0.2),
        ("table_axis_tilt_{}_deg", 0.02),
        ("jack_line_tilt_{}_deg", 0.05),
        ("stage_{}_turn_deg", 0.05),
    ):
        angle = generator.uniform(0.0, 2.0 * np.pi)
        found |= {name.format("x"): size * float(np.cos(angle)), name.format("y"): size * float(np.sin(angle))}
    found["force_gain"] = 1.0 + 0.1 * float(generator.choice([-1.0, 1.0]))
    found["force_offset_n"] = float(generator.uniform(-20.0, 20.0))
    return found


def _direction(generator: np.random.Generator) -> list[float]:
    vector = generator.normal(size=3)
    return [float(value) for value in vector / np.linalg.norm(vector)]


def calibrated(
    config: CellConfig, recipe: Recipe, seed: int, procedures: tuple[Procedure, ...] = ALL, looks: int = 6
) -> Calibration:
    """What the procedures make of the cell's own file, one after the other."""
    found = load_calibration(config.calibration_path)
    for procedure in procedures:
        found = calibrate_once(CalibrationRequest(procedure, config, found, recipe, seed, looks=looks))
    return found


def believing(config: CellConfig, calibration: Calibration, folder: Path) -> CellConfig:
    """The same cell with that calibration, in a file of `folder`."""
    save_calibration(folder / "calibration.toml", calibration)
    return config.model_copy(update={"calibration": CalibrationEntry(file=folder / "calibration.toml")})


def overridden(config: CellConfig, numbers: Mapping[str, float]) -> CellConfig:
    """The same cell on a twin with these numbers too."""
    twin = config.twin.model_copy(update={"overrides": {**config.twin.overrides, **numbers}})
    return config.model_copy(update={"twin": twin})
