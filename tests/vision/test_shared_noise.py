"""Noise that pixels share: measured on a face, applied without building its matrix, used beside a hole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cellctl.vision.measure import measure_part
from cellctl.vision.shared_noise import SharedNoise, between, correlated, estimate
from tests.vision.parts import SHAFT
from tests.vision.synthetic import render
from tests.vision.test_holes import centre_errors, view_of


def smooth(rng: np.random.Generator, length: float, size: int = 300) -> np.ndarray:
    field = gaussian_filter(rng.standard_normal((size, size)), length / 2.0, mode="wrap")
    return np.asarray(field / field.std())


@pytest.mark.parametrize("length", [1.5, 3.0, 4.5])
def test_length_is_found_beside_gaps_and_ripple(length: float) -> None:
    rng = np.random.default_rng(1)
    image = 0.03 * smooth(rng, length) + 0.01 * np.sin(np.arange(300) / 25.0)
    image[rng.random(image.shape) < 0.2] = np.nan
    found = estimate(image, 0.031)
    assert found is not None
    assert found.length_px == pytest.approx(length, rel=0.1)
    assert found.share > 0.9


def test_share_is_found() -> None:
    rng = np.random.default_rng(2)
    image = 0.03 * (np.sqrt(0.6) * smooth(rng, 3.0) + np.sqrt(0.4) * rng.standard_normal((300, 300)))
    found = estimate(image, 0.03)
    assert found is not None and found.share == pytest.approx(0.6, abs=0.06)


def test_white_noise_is_none() -> None:
    rng = np.random.default_rng(3)
    assert estimate(0.03 * rng.standard_normal((300, 300)), 0.03) is None
    assert estimate(np.full((300, 300), np.nan), 0.03) is None
    assert estimate(0.03 * smooth(rng, 3.0, 20), 0.03) is None


@pytest.mark.parametrize("length", [2.0, 3.0])
def test_a_few_scattered_pixels_show_the_length_too(length: float) -> None:
    rng = np.random.default_rng(6)
    field, pixels = smooth(rng, length, 120), np.argwhere(rng.random((120, 120)) > 0.33)
    found = between(pixels, field[tuple(pixels.T)])
    assert found is not None
    assert found.length_px == pytest.approx(length, abs=0.35)
    assert found.share > 0.9


def test_white_noise_of_a_few_pixels_is_none() -> None:
    rng = np.random.default_rng(7)
    pixels = np.argwhere(rng.random((120, 120)) > 0.33)
    assert between(pixels, rng.standard_normal(len(pixels))) is None
    assert between(pixels[:50], np.ones(50)) is None


def test_correlated_is_the_dense_product() -> None:
    rng = np.random.default_rng(4)
    pixels = np.argwhere(rng.random((20, 25)) < 0.5).astype(float) + 7.0
    noise = SharedNoise(2.7, 0.8)
    distance2 = ((pixels[:, None] - pixels[None]) ** 2).sum(axis=2)
    dense = 0.8 * np.exp(-distance2 / 2.7**2) + 0.2 * np.eye(len(pixels))
    columns = rng.standard_normal((len(pixels), 4))
    assert np.allclose(correlated(columns, pixels, noise), dense @ columns)


def test_holes_under_shared_noise() -> None:
    """A plain fit would scatter by some 25 um here, as its inflated covariance says; the field takes most of it."""
    squares, distances = [], []
    for seed in range(3):
        rng = np.random.default_rng(60 + seed)
        view = replace(view_of(SHAFT, rng, 600), correlation_px=3.0)
        measured = measure_part(render(view, rng), SHAFT)
        assert measured.found == 36
        error = centre_errors(view, measured)[:, :2]
        squares.append((error**2).sum(axis=1).mean())
        rotation = view.T_scanner_part[:3, :3]
        for feature, miss in zip(measured.features, error, strict=True):
            assert feature.covariance_mm2 is not None
            own = (rotation.T @ feature.covariance_mm2 @ rotation)[:2, :2]
            distances.append(miss @ np.linalg.solve(own, miss) / 2)
    assert np.sqrt(np.mean(squares)) < 0.006
    assert 0.5 < np.mean(distances) < 2.2
