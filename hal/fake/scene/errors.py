"""What the instrument makes of the true picture: blind spots, noise, ripple, scale, flying pixels, outliers, bands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hal.fake.scene.camera import Camera, ScanErrors
from hal.fake.scene.hits import FLAT, HitBuffer, Mask, dot

Array = NDArray[np.float64]
Image = NDArray[np.float32]


def measured(hits: HitBuffer, errors: ScanErrors, rng: np.random.Generator) -> Image:
    """(rows, cols, 3) float32 cloud of the hits; NaN where nothing was measured."""
    camera = hits.camera
    length = np.sqrt(1.0 + hits.u**2 + hits.v**2)
    facing = -(hits.normal[:, 0] * hits.u + hits.normal[:, 1] * hits.v + hits.normal[:, 2]) / length
    valid = seen(hits, errors, facing)
    depth = np.where(valid, hits.depth, np.nan)

    in_band = _bands(hits, errors, rng)
    _fly(hits, depth, errors, rng)
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = errors.noise_mm * (depth / camera.reference_mm) ** 2 / facing
    sigma[in_band] *= errors.band_noise
    along = sigma * correlated_noise(camera, errors, rng) + _ripple(hits, depth, errors)
    depth += along / length
    depth[in_band & (rng.random(depth.size) < errors.band_loss)] = np.nan
    wild = np.flatnonzero(rng.random(depth.size, dtype=np.float32) < errors.outliers)
    depth[wild] += rng.laplace(0.0, errors.outlier_depth_mm, wild.size)

    depth *= 1.0 + errors.scale
    cloud = np.empty((camera.rows * camera.cols, 3), dtype=np.float32)
    cloud[:, 0], cloud[:, 1], cloud[:, 2] = hits.u * depth, hits.v * depth, depth
    return cloud.reshape(camera.rows, camera.cols, 3)


def seen(hits: HitBuffer, errors: ScanErrors, facing: Array) -> Mask:
    """Which pixels give data: in focus, seen by both eyes, not steep, not glaring. `facing` is the cosine of the
    incidence angle at the pixel's own ray."""
    camera = hits.camera
    valid = (hits.depth >= camera.near_mm) & (hits.depth <= camera.far_mm) & ~hits.dark
    valid &= facing >= np.cos(np.radians(errors.steep_deg))
    # A flat face can glare only where the ray comes close to its normal; the eyes see it no steeper than 45 degrees.
    parallax = max((float(np.hypot(eye[0], eye[1])) for eye in camera.eyes_mm), default=0.0) / camera.near_mm
    near_normal = facing > np.cos(np.radians(errors.glare_deg) + 0.5 * np.arctan(parallax))
    pixels = np.flatnonzero(valid & ((hits.owner != FLAT) | near_normal))
    points, normal = hits.points(pixels), hits.normal[pixels].astype(np.float64)
    back = -points / np.sqrt(dot(points, points))[:, None]
    good = np.ones(pixels.size, dtype=np.bool_)
    for eye in camera.eyes_mm:
        towards = np.asarray(eye) - points
        towards /= np.sqrt(dot(towards, towards))[:, None]
        good &= dot(towards, normal) >= np.cos(np.radians(errors.eye_steep_deg))
        half = back + towards
        mirror = dot(half, normal) / np.sqrt(dot(half, half))
        good &= mirror <= np.cos(np.radians(errors.glare_deg))
    valid[pixels[~good]] = False
    return valid


def correlated_noise(camera: Camera, errors: ScanErrors, rng: np.random.Generator) -> Array:
    """(rows * cols,) of unit variance whose correlation falls to 1/e at `correlation_px`.

    White noise smoothed with a Gaussian of width s has the correlation exp(-d^2 / 4 s^2), so s is half that distance.
    """
    white: Image = rng.standard_normal((camera.rows, camera.cols), dtype=np.float32)
    width = 0.5 * errors.correlation_px
    if width > 0.0:
        at = np.arange(-np.ceil(3.0 * width), np.ceil(3.0 * width) + 1.0)
        kernel = np.exp(-0.5 * (at / width) ** 2)
        kernel /= np.sqrt(np.sum(kernel**2))
        for axis in (0, 1):
            smooth = ndimage.correlate1d(white, kernel, axis=axis, mode="wrap")
            white = np.asarray(smooth, dtype=np.float32)
    return white.ravel().astype(np.float64)


def _ripple(hits: HitBuffer, depth: Array, errors: ScanErrors) -> Array | float:
    """Long-wave fringe error along the ray: looks like motion, and no residual shows it."""
    if errors.ripple_mm == 0.0:
        return 0.0
    angle = np.radians(errors.ripple_angle_deg)
    across = (hits.u * np.cos(angle) + hits.v * np.sin(angle)) * depth
    phase = 2.0 * np.pi * across / errors.ripple_wavelength_mm + np.radians(errors.ripple_phase_deg)
    return np.asarray(np.sqrt(2.0) * errors.ripple_mm * np.sin(phase))


def _fly(hits: HitBuffer, depth: Array, errors: ScanErrors, rng: np.random.Generator) -> None:
    """Move pixels at depth edges to somewhere between the two surfaces, in place."""
    shape = (hits.camera.rows, hits.camera.cols)
    true, owner, image = depth.copy().reshape(shape), hits.owner.reshape(shape), depth.reshape(shape)
    for here, there in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        step = true[there] - true[here]
        with np.errstate(invalid="ignore"):
            edge = np.abs(step) > errors.edge_step_mm
        edge &= (owner[here] != owner[there]) | (owner[here] == FLAT)
        rows = np.nonzero(edge)
        side, share, hit = rng.random((3, rows[0].size))
        fly = hit < errors.flying
        image[here][rows] += np.where(fly & (side < 0.5), share * step[rows], 0.0)
        image[there][rows] -= np.where(fly & (side >= 0.5), share * step[rows], 0.0)


def _bands(hits: HitBuffer, errors: ScanErrors, rng: np.random.Generator) -> Mask:
    """Pixels under bands of stray light, anew for each capture."""
    half = hits.camera.half_width
    band = np.zeros(hits.u.size, dtype=np.bool_)
    for _ in range(errors.bands):
        angle, place = rng.uniform(0.0, np.pi), rng.uniform(-half, half)
        across = hits.u * np.cos(angle) + hits.v * np.sin(angle) - place
        band |= np.abs(across) < errors.band_width * half
    return band
