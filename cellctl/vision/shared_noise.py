"""Noise that neighbouring pixels share: how far it reaches, as residuals on the pixel grid show it.

Structured light decodes depth over a neighbourhood, so errors are smooth across a few pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array
from cellctl.vision.stencil import neighbours

Image = NDArray[np.float32]

LAGS = np.arange(1, 7)
FAR_LAGS = (12, 15)
LEAST_NEIGHBOUR = 0.15  # correlation of next neighbours below which noise counts as white
CLIP = 3.5
BAND_PIXELS = 200_000
LEAST_PAIRS, LEAST_FAR, LEAST_WHITE = 100, 0.01, 0.05
"""Without a white part rounding and the model's own errors would decide."""


@dataclass(frozen=True, slots=True)
class SharedNoise:
    """Correlation of the errors of two pixels d apart: `share` exp(-d^2 / length_px^2); the rest is white."""

    length_px: float
    share: float

    def at(self, square_px: Array) -> Array:
        """Correlation at squared distances > 0."""
        return np.asarray(self.share * np.exp(-square_px / self.length_px**2))


def on_face(points: Columns, normal: Array, distance_mm: float, sigma_mm: float) -> SharedNoise | None:
    """What the residuals of the face's own points about its plane, normal . p = distance, say on the pixel grid.

    A band of image rows across the face shows it as well as the whole.
    """
    assert points.pixels is not None
    height, width = points.shape
    starts = np.searchsorted(points.pixels, width * np.arange(height + 1))
    band = int(min(height, max(4 * FAR_LAGS[-1], np.ceil(BAND_PIXELS / width))))
    top = int(np.argmax(starts[band:] - starts[:-band]))
    chosen = points.take(np.s_[starts[top] : starts[top + band]])
    assert chosen.pixels is not None
    image = np.full((band, width), np.nan, dtype=np.float32)
    image.reshape(-1)[chosen.pixels - top * width] = chosen.above(normal, distance_mm)
    return estimate(image, sigma_mm)


def estimate(residuals: NDArray[np.floating], sigma: float) -> SharedNoise | None:
    """From the face's residuals on the pixel grid (H, W), NaN elsewhere; None where they are as good as white.

    What correlates over more than a dozen pixels is ripple, which belongs to type B, and is taken off.
    """
    used = np.abs(residuals) < CLIP * sigma  # False for NaN
    if np.count_nonzero(used) < 2000 or min(used.shape) <= 2 * FAR_LAGS[-1]:
        return None
    z = np.where(used, residuals, 0.0).astype(np.float32)
    mask = used.astype(np.float32)
    variance = float(np.square(z).sum(dtype=np.float64)) / float(np.count_nonzero(used))
    near = [_correlation(z, mask, 1) / variance]
    if near[0] < LEAST_NEIGHBOUR:
        return None
    near += [_correlation(z, mask, int(lag)) / variance for lag in LAGS[1:]]
    far = float(np.mean([_correlation(z, mask, lag) / variance for lag in FAR_LAGS]))
    rho = (np.array(near) - far) / max(1.0 - far, 0.1)
    if not np.isfinite(rho).all() or rho[0] < LEAST_NEIGHBOUR:
        return None
    lengths = np.linspace(0.6, 8.0, 75)
    shapes = np.exp(-((LAGS[None] / lengths[:, None]) ** 2))
    shares = np.clip((shapes @ rho) / (shapes**2).sum(axis=1), 0.0, 1.0)
    best = int(np.argmin(((rho - shares[:, None] * shapes) ** 2).sum(axis=1)))
    return SharedNoise(float(lengths[best]), float(shares[best]))


def _correlation(z: Image, mask: Image, lag: int) -> float:
    """Mean product of pixels `lag` apart in rows and columns; `z` is zero where `mask` is."""
    sums = count = 0.0
    for ahead, behind in ((np.s_[lag:], np.s_[:-lag]), (np.s_[:, lag:], np.s_[:, :-lag])):
        sums += float((z[ahead] * z[behind]).sum(dtype=np.float64))
        count += float((mask[ahead] * mask[behind]).sum(dtype=np.float64))
    return sums / max(count, 1.0)


def between(pixels: NDArray[np.intp], residuals: Array) -> SharedNoise | None:
    """What residuals (N,) of unit variance at `pixels` (N, 2), not enough of them for an image, have in common one and
    two pixels apart; None where they are as good as white."""
    power, shared = float(np.mean(residuals**2)), []
    for other in neighbours(pixels, np.array([[0, -1], [-1, 0], [0, -2], [-2, 0]])):
        pairs = np.flatnonzero(other >= 0)
        enough = len(pairs) >= LEAST_PAIRS
        shared.append(float(np.mean(residuals[pairs] * residuals[other[pairs]])) / power if enough else 0.0)
    near, far = 0.5 * (shared[0] + shared[1]), 0.5 * (shared[2] + shared[3])
    if near < LEAST_NEIGHBOUR or far <= LEAST_FAR:
        return None
    length = float(np.clip(np.sqrt(3.0 / np.log(max(near / far, 1.1))), 0.7, 5.0))
    return SharedNoise(length, float(np.clip(near * np.exp(length**-2.0), 0.1, 1.0 - LEAST_WHITE)))


def correlated(columns: Array, pixels: Array, noise: SharedNoise) -> Array:
    """R @ columns (M, q) for the correlation matrix R of the noise at pixels (M, 2), all different.

    On the grid the Gaussian separates into rows and columns, so R is never built.
    """
    rows, places = (np.rint(side - side.min()).astype(np.intp) for side in pixels.T)
    height, width = int(rows.max()) + 1, int(places.max()) + 1
    image = np.zeros((height, width, columns.shape[1]))
    image[rows, places] = columns
    across, along = (np.exp(-((np.subtract.outer(np.arange(n), np.arange(n)) / noise.length_px) ** 2))
                     for n in (height, width))  # fmt: skip
    smooth = (across @ (along @ image).reshape(height, -1)).reshape(image.shape)
    return np.asarray(noise.share * smooth[rows, places] + (1.0 - noise.share) * columns)
