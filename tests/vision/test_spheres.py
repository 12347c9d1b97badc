"""The sphere artefact on exact clouds: residuals of a moved artefact, stems in view, a sphere that is not there."""

import numpy as np
import pytest

from cellctl.vision.part import Refused
from cellctl.vision.spheres import artefact_residuals

T = np.diag([1.0, -1.0, -1.0, 1.0])
T[2, 3] = 350.0
CENTRES = np.array([[135.0, 135.0, 15.0], [-135.0, 133.0, 20.0], [-133.0, -135.0, 10.0], [135.0, -131.0, 25.0]])


def cloud_of(centres_cell: np.ndarray, generator: np.random.Generator, *, sigma: float = 0.03) -> np.ndarray:
    """Organised 500 x 500 cloud in the scanner frame of spheres on 6 mm stems that lead outwards, and 2 % outliers."""
    slope = ((np.arange(500) + 0.5) / 250 - 1) * 0.47
    u, v = np.meshgrid(slope, slope)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    depth = np.full(len(rays), np.inf)
    for centre in centres_cell @ T[:3, :3].T + T[:3, 3]:
        for k in range(60):
            place = centre + np.array([centre[0], centre[1], 0.0]) / 190.0 * 0.5 * k
            radius = 10.0 if k == 0 else 3.0
            middle = rays @ place
            square = radius**2 - (place @ place - middle**2)
            depth = np.minimum(depth, np.where(square > 0, middle - np.sqrt(np.maximum(square, 0)), np.inf))
    met = np.isfinite(depth)
    depth[met] += generator.normal(0, sigma, met.sum())
    wild = met & (generator.random(len(depth)) < 0.02)
    depth[wild] += generator.uniform(-5, 5, wild.sum())
    points = np.where(met[:, None], rays * np.where(met, depth, 0.0)[:, None], np.nan)
    return points.astype(np.float32).reshape(500, 500, 3)


def test_residuals_are_the_displacements() -> None:
    for seed in range(3):
        generator = np.random.default_rng(seed)
        moved = generator.normal(0, 0.5, (4, 3))
        found = artefact_residuals(cloud_of(CENTRES + moved, generator), T, CENTRES, 20.0)
        assert np.abs(found - moved).max() < 0.012


def test_without_noise_the_fit_is_exact() -> None:
    generator = np.random.default_rng(4)
    found = artefact_residuals(cloud_of(CENTRES + np.array([1.0, -2.0, 0.5]), generator, sigma=0.0), T, CENTRES, 20.0)
    np.testing.assert_allclose(found, np.tile([1.0, -2.0, 0.5], (4, 1)), atol=2e-3)


def test_a_bench_that_moved_a_few_millimetres_is_measured_and_one_that_left_is_refused() -> None:
    generator = np.random.default_rng(5)
    found = artefact_residuals(cloud_of(CENTRES + np.array([5.0, 0.0, 0.0]), generator), T, CENTRES, 20.0)
    assert found[:, 0] == pytest.approx(5.0, abs=0.02)
    with pytest.raises(Refused, match="artefact_moved"):
        artefact_residuals(cloud_of(CENTRES + np.array([30.0, 0.0, 0.0]), generator), T, CENTRES, 20.0)


def test_a_sphere_of_another_size_is_refused() -> None:
    generator = np.random.default_rng(6)
    with pytest.raises(Refused, match="artefact_moved"):
        artefact_residuals(cloud_of(CENTRES, generator), T, CENTRES, 30.0)


def test_an_empty_cloud_is_refused() -> None:
    with pytest.raises(Refused, match="artefact_moved"):
        artefact_residuals(np.full((10, 10, 3), np.nan, dtype=np.float32), T, CENTRES, 20.0)
