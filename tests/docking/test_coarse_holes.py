"""Holes of the twin in a coarse picture, where few patches of shared noise make up a hole: stated as they are."""

import numpy as np

from cellctl.vision.measure import measure_part
from hal.fake.scene.picture import picture_of
from hal.fake.scene.render import render
from tests.docking.twin_cases import case, default_recipe

SEEDS = range(31, 35)
QUIET = {"scanner_ripple_mm": 0.0, "scanner_scale": 0.0, "scanner_outliers": 0.0, "scanner_correlation_px": 3.0}


def _off(seed: int) -> np.ndarray:
    """(n, 2) errors of the hole centres in their pattern, over the sigma that is stated."""
    one = case(seed, default_recipe())
    one = type(one)(one.recipe, one.calibration, one.seed, {**one.overrides, **QUIET})
    plant = one.plant()
    part = measure_part(
        render(picture_of(plant, "shaft", 100_000), seed),
        one.recipe.part("shaft"),
        one.calibration.views["shaft"].matrix,
    )
    inverse = np.linalg.inv(part.T_frame_part)
    pose = inverse @ plant.T_cell_shaft()
    seen = np.array([feature.center_mm for feature in part.features]) @ inverse[:3, :3].T + inverse[:3, 3]
    true = np.column_stack([plant.shaft.hole_mm, np.zeros(len(seen))]) @ pose[:3, :3].T + pose[:3, 3]
    near = np.argmin(np.linalg.norm(seen[:, None, :2] - true[None, :, :2], axis=2), axis=1)
    x, y = seen[:, :2].T
    unit, none = np.ones(len(x)), np.zeros(len(x))
    design = np.stack([np.column_stack([unit, none, -y, x]), np.column_stack([none, unit, x, y])], axis=1).reshape(
        -1, 4
    )
    rest = (seen[:, :2] - true[near, :2]).ravel()
    rest = rest - design @ np.linalg.lstsq(design, rest, rcond=None)[0]
    stated = [0.5 * np.trace(feature.covariance_mm2[:2, :2]) for feature in part.features]
    return rest.reshape(-1, 2) / np.sqrt(stated)[:, None]


def test_a_coarse_picture_does_not_make_holes_surer_than_they_are() -> None:
    ratio = np.mean([np.mean(_off(seed) ** 2) for seed in SEEDS])
    assert 0.35 < ratio < 1.5, ratio
