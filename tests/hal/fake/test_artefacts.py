"""The bench's furniture: seen from where it must be seen, clear of the parts, and as the certificate says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellctl.calibration import load_calibration
from hal.fake.scene.artefacts import BenchFurniture
from hal.fake.scene.render import render
from hal.fake.scene.shapes import Clutter
from tests.hal.fake.scene_model import scene


def test_built_as_certified(root: Path) -> None:
    certificate, bench = load_calibration(root / "deploy/calibration.fake.toml").artefact, BenchFurniture()
    assert certificate.sphere_diameter_mm == bench.sphere_diameter_mm
    assert certificate.rotor_side_mm == bench.rotor_side_mm
    assert certificate.shaft_side_mm == bench.shaft_side_mm


@pytest.mark.parametrize("view", ["rotor", "shaft"])
def test_each_view_sees_its_spheres_freely(view: str) -> None:
    state = scene(view, points=160_000)
    bench = BenchFurniture()
    cloud = render(state, 1).reshape(-1, 3)
    cell = cloud @ state.T_cell_camera[:3, :3].T + state.T_cell_camera[:3, 3]
    for center in bench.rotor_side_mm if view == "rotor" else bench.shaft_side_mm:
        on_sphere = np.abs(np.linalg.norm(cell - center, axis=1) - 0.5 * bench.sphere_diameter_mm) < 2e-4
        assert on_sphere.sum() > 250
        # All around: no post or stem stands before it.
        towards = (state.T_cell_camera[:3, 3] - center) / np.linalg.norm(state.T_cell_camera[:3, 3] - center)
        middle = (cell[on_sphere] - center).mean(axis=0)
        middle /= np.linalg.norm(middle)
        assert np.degrees(np.arccos(middle @ towards)) < 8.0


@pytest.mark.parametrize("view", ["rotor", "shaft"])
def test_furniture_costs_the_part_nothing(view: str) -> None:
    state = scene(view, points=90_000)
    empty = render(replace(state, clutter=Clutter()), 1)
    full = render(state, 1)
    lost = np.isfinite(empty[..., 0]) & ~np.isclose(empty, full, equal_nan=True).all(axis=2)
    assert lost.sum() < 0.002 * np.isfinite(empty[..., 0]).sum()
