"""Correlated noise: its length is found, whitened rows are independent, estimates carry an honest sigma."""

import numpy as np
import pytest
from scipy import ndimage

from cellctl.vision.correlation import Correlation, PixelGrid, Whitener, estimate


def field(generator: np.random.Generator, length: float, shape: tuple[int, int] = (120, 120)) -> np.ndarray:
    white = generator.standard_normal(shape)
    if length == 0:
        return white
    smooth = ndimage.gaussian_filter(white, 0.5 * length, mode="wrap")
    return smooth / smooth.std()


def grid_of(keep: np.ndarray, shape: tuple[int, int]) -> PixelGrid:
    grid = PixelGrid.of(np.flatnonzero(keep.ravel()), shape)
    assert grid is not None
    return grid


@pytest.mark.parametrize("length", [0.0, 2.0, 3.0])
def test_the_length_is_found_with_a_third_of_the_pixels_lost(length: float) -> None:
    generator = np.random.default_rng(1)
    noise, keep = field(generator, length), generator.random((120, 120)) > 0.33
    found = estimate(grid_of(keep, keep.shape), noise[keep])
    assert found.length_px == pytest.approx(length, abs=0.35)


def test_whitened_noise_is_white() -> None:
    generator = np.random.default_rng(2)
    noise = 0.9**0.5 * field(generator, 3.0) + 0.1**0.5 * generator.standard_normal((120, 120))
    keep = generator.random((120, 120)) > 0.2
    grid = grid_of(keep, keep.shape)
    white = Whitener.of(grid, np.zeros(keep.sum(), dtype=np.intp), Correlation(3.0, 0.1)).apply(noise[keep][None])
    assert np.std(white[0]) == pytest.approx(1.0, abs=0.05)
    for down, right in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0)):
        other = grid.neighbour(down, right)
        pairs = other >= 0
        assert abs(np.mean(white[0, pairs] * white[0, other[pairs]])) < 0.12


def test_the_sigma_of_a_mean_is_honest() -> None:
    generator = np.random.default_rng(3)
    keep = generator.random((14, 14)) > 0.2
    whitener = Whitener.of(grid_of(keep, keep.shape), np.zeros(keep.sum(), dtype=np.intp), Correlation(3.0, 0.05))
    design = whitener.apply(np.ones((1, keep.sum())))
    power = float(np.sum(design**2))
    means = [
        float(np.sum(design * whitener.apply(field(generator, 3.0)[:14, :14][keep][None]))) / power for _ in range(300)
    ]
    assert np.std(means) * np.sqrt(power) == pytest.approx(1.0, abs=0.15)


def test_groups_do_not_speak_for_each_other() -> None:
    grid = grid_of(np.ones((4, 4), dtype=bool), (4, 4))
    group = np.arange(16, dtype=np.intp)
    rows = np.random.default_rng(4).normal(size=(2, 16))
    np.testing.assert_allclose(Whitener.of(grid, group, Correlation(3.0, 0.05)).apply(rows), rows)


def test_a_cloud_without_order_has_no_grid() -> None:
    assert PixelGrid.of(np.arange(5), (5,)) is None
