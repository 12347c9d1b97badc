"""Exact measurements of a rotor and a shaft in the cell, for given axis positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellctl.calibration import Calibration, load_calibration
from cellctl.kinematics import rotation_about
from cellctl.recipe import Recipe, load_recipe
from cellctl.vision.part import FaceFit, FeatureFit, PartMeasurement

ROOT = Path(__file__).parents[2]
HEIGHT = 400.0


def calibration() -> Calibration:
    return load_calibration(ROOT / "deploy" / "calibration.fake.toml")


def recipe() -> Recipe:
    return load_recipe(ROOT / "recipes" / "lpt_shaft_36.toml")


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0, down: bool = False) -> np.ndarray:
    """(4, 4) of a part whose pattern centre stands at x, y, z, turned about the cell's z; `down` flips it about x."""
    T = np.eye(4)
    T[:3, :3] = rotation_about(np.array([0, 0, 1.0]), np.radians(turn_deg))
    if down:
        T[:3, :3] = T[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    T[:3, 3] = x, y, z
    return T


def measurement(
    feature: str,
    T_cell_part: np.ndarray,
    angles_deg: tuple[float, ...],
    *,
    errors: np.ndarray | None = None,
    sigma_mm: float = 0.005,
    clocking_free: bool = False,
    shift: int = 0,
) -> PartMeasurement:
    """`errors` (n, 2) move the centres in the part frame; feature k of the result is feature k + shift of the part."""
    angles = np.radians(angles_deg)
    centres = 120.0 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    if errors is not None:
        centres[:, :2] += errors
    cell = np.roll(centres, -shift, axis=0) @ T_cell_part[:3, :3].T + T_cell_part[:3, 3]
    normal = T_cell_part[:3, 2]
    face = FaceFit(T_cell_part[:3, 3], normal, T_cell_part[:3, :2].T, np.eye(3) * 1e-12, 0.03, 0.01, 1000, 0.99)
    features = tuple(FeatureFit(i, True, c, normal, 4.0, np.eye(3) * sigma_mm**2, 0.01) for i, c in enumerate(cell))
    return PartMeasurement(
        "cell", "hole" if feature == "hole" else "stud", face, T_cell_part, np.eye(6) * 1e-10, 0.001, clocking_free,
        features, 240.0,
    )  # fmt: skip
