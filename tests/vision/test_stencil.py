"""Rows freed from shared noise: exact where the stencil sees everything, and its transpose."""

from __future__ import annotations

import numpy as np

from cellctl.vision.shared_noise import SharedNoise
from cellctl.vision.stencil import Stencil


def field(
    rng: np.random.Generator, pixels: np.ndarray, noise: SharedNoise, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draws (count, N) of the noise and its correlation matrix."""
    square = ((pixels[:, None] - pixels[None]) ** 2).sum(axis=2).astype(float)
    matrix = np.where(square > 0, noise.at(np.maximum(square, 1.0)), 1.0)
    return rng.standard_normal((count, len(pixels))) @ np.linalg.cholesky(matrix).T, matrix


def test_a_row_of_pixels_is_freed_exactly() -> None:
    """Along one row of four pixels every point sees all before it: W R W^T is the identity."""
    pixels = np.array([[0, 0], [0, 1], [0, 2], [0, 3]])
    noise = SharedNoise(1.5, 0.9)
    _, matrix = field(np.random.default_rng(0), pixels, noise, 1)
    free = Stencil.of(pixels, np.zeros(4, dtype=np.intp), noise.at).apply(np.eye(4)).T
    assert np.allclose(free @ matrix @ free.T, np.eye(4), atol=1e-12)


def test_noise_with_gaps_becomes_white() -> None:
    rng = np.random.default_rng(1)
    pixels = np.argwhere(rng.random((24, 24)) < 0.85)
    noise = SharedNoise(3.0, 0.97)
    draws, _ = field(rng, pixels, noise, 400)
    free = Stencil.of(pixels, np.zeros(len(pixels), dtype=np.intp), noise.at).apply(draws)
    correlation = free.T @ free / 400
    assert abs(np.diag(correlation).mean() - 1.0) < 0.02
    # neighbours beyond the stencil leave a trace; without it the mean square off the diagonal is 0.02
    off = correlation - np.diag(np.diag(correlation))
    assert np.mean(off**2) < 1.25 / 400


def test_groups_do_not_speak_for_each_other() -> None:
    pixels = np.argwhere(np.ones((6, 6)))
    group = (pixels[:, 1] > 2).astype(np.intp)
    noise = SharedNoise(2.0, 0.9)
    rows = np.where(group == 0, 1.0, 0.0)[None]
    assert np.all(Stencil.of(pixels, group, noise.at).apply(rows)[0, group == 1] == 0.0)


def test_back_is_the_transpose() -> None:
    rng = np.random.default_rng(2)
    pixels = np.argwhere(rng.random((12, 15)) < 0.7)
    stencil = Stencil.of(pixels, np.zeros(len(pixels), dtype=np.intp), SharedNoise(2.5, 0.95).at)
    x, y = rng.standard_normal((2, 3, len(pixels)))
    assert np.allclose(np.einsum("qn,qn->q", stencil.apply(x), y), np.einsum("qn,qn->q", x, stencil.back(y)))


def test_the_sigma_of_a_mean_is_honest() -> None:
    rng = np.random.default_rng(5)
    pixels, noise = np.argwhere(rng.random((14, 14)) > 0.2), SharedNoise(3.0, 0.95)
    draws, _ = field(rng, pixels, noise, 400)
    stencil = Stencil.of(pixels, np.zeros(len(pixels), dtype=np.intp), noise.at, places=10)
    design = stencil.apply(np.ones((1, len(pixels))))[0]
    power = float(design @ design)
    assert abs(np.std(stencil.apply(draws) @ design / power) * np.sqrt(power) - 1.0) < 0.15
