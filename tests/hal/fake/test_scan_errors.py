"""The instrument's errors have the strengths that the numbers say."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hal.fake.scene.camera import IDEAL, ScanErrors, camera_for
from hal.fake.scene.errors import correlated_noise, measured, seen
from hal.fake.scene.render import SceneState, render, trace
from hal.fake.scene.shapes import PartShape
from tests.hal.fake.scene_model import scene

Array = NDArray[np.float64]


def plate(errors: ScanErrors, depth_mm: float = 350.0, tilt_deg: float = 0.0, points: int = 160_000) -> SceneState:
    """A wide plate, tilted about x, that fills most of the view."""
    a = np.radians(tilt_deg)
    T = np.array([[1, 0, 0, 0], [0, -np.cos(a), np.sin(a), 0], [0, -np.sin(a), -np.cos(a), depth_mm], [0, 0, 0, 1]])
    return SceneState(np.eye(4), ((T, PartShape(((0.0, 120.0, 0.0),))),), camera=camera_for(points), errors=errors)


def along_ray(state: SceneState, seed: int = 1) -> Array:
    """Error of each pixel along its ray, (rows, cols), NaN where nothing was measured."""
    true = render(replace(state, errors=IDEAL), 1).astype(np.float64)
    error = render(state, seed).astype(np.float64) - true
    return np.asarray(np.sum(error * true, axis=2) / np.linalg.norm(true, axis=2))


@pytest.mark.parametrize(("depth_mm", "tilt_deg"), [(350.0, 0.0), (400.0, 0.0), (300.0, 0.0), (350.0, 40.0)])
def test_noise_grows_with_depth_squared_and_incidence(depth_mm: float, tilt_deg: float) -> None:
    state = plate(replace(IDEAL, noise_mm=0.03), depth_mm, tilt_deg)
    error = along_ray(state)
    center = error[180:220, 180:220]
    expected = 0.03 * (depth_mm / 350.0) ** 2 / np.cos(np.radians(tilt_deg))
    assert np.nanstd(center) == pytest.approx(expected, rel=0.06)
    assert abs(np.nanmean(error)) < 0.001


def test_correlation_falls_to_one_over_e_at_its_length() -> None:
    rng = np.random.default_rng(4)
    for length in (0.0, 3.0, 5.0):
        field = correlated_noise(camera_for(400_000), replace(IDEAL, correlation_px=length), rng).reshape(632, 632)
        assert field.std() == pytest.approx(1.0, abs=0.03)
        for shift in (3, 5):
            expected = np.exp(-((shift / length) ** 2)) if length else 0.0
            for shifted in (np.roll(field, shift, axis=0), np.roll(field, shift, axis=1)):
                assert np.mean(field * shifted) == pytest.approx(expected, abs=0.03)


def test_scale_stretches_the_cloud_and_ripple_waves_along_the_ray() -> None:
    state = plate(replace(IDEAL, scale=1e-3))
    true, seen_cloud = render(replace(state, errors=IDEAL), 1), render(state, 1)
    np.testing.assert_allclose(seen_cloud, true * np.float32(1.001), rtol=1e-6)
    ripple = along_ray(plate(replace(IDEAL, ripple_mm=0.02, ripple_angle_deg=0.0, ripple_wavelength_mm=50.0)))
    assert np.nanmax(ripple) == pytest.approx(0.02 * 2.0**0.5, abs=1e-4)
    assert np.nanmin(ripple) == pytest.approx(-0.02 * 2.0**0.5, abs=1e-4)
    assert np.nanstd(ripple) == pytest.approx(0.02, rel=0.05)
    row = ripple[200][np.isfinite(ripple[200])]
    pitch_mm = 330.0 / 399.0
    turns = np.count_nonzero(np.diff(np.sign(row))) / 2.0
    assert turns == pytest.approx(row.size * pitch_mm / 50.0, abs=1.0)


def test_share_of_outliers_and_of_flying_pixels() -> None:
    error = along_ray(plate(replace(IDEAL, outliers=0.03)))
    assert np.mean(np.abs(error[np.isfinite(error)]) > 1e-3) == pytest.approx(0.03, abs=0.002)
    state = scene("shaft", points=160_000)
    flown = along_ray(replace(state, errors=replace(IDEAL, flying=0.5)))
    wrong = np.abs(flown) > 1e-3
    # Only pixels at depth edges fly, and only between the two surfaces.
    assert 50 < wrong.sum() < 0.02 * np.isfinite(flown).sum()
    depth = render(state, 1)[..., 2].astype(np.float64)
    rows, cols = np.nonzero(wrong)
    near = np.stack([depth[rows + i, cols + j] for i, j in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))])
    moved_to = render(replace(state, errors=replace(IDEAL, flying=0.5)), 1)[rows, cols, 2]
    # A pixel may be moved twice, at a corner, by what its neighbours left: allow the edge's own step.
    step = np.nanmax(near, axis=0) - np.nanmin(near, axis=0)
    assert (moved_to > np.nanmin(near, axis=0) - step - 1e-3).all()
    assert (moved_to < np.nanmax(near, axis=0) + step + 1e-3).all()


def test_bands_lose_pixels_and_are_noisier() -> None:
    quiet = replace(IDEAL, noise_mm=0.01)
    state = plate(replace(quiet, bands=3, band_width=0.1, band_loss=0.5, band_noise=5.0))
    error, plain = along_ray(state), along_ray(plate(quiet))
    lost = np.isnan(error) & np.isfinite(plain)
    assert 0.02 < lost.sum() / np.isfinite(plain).sum() < 0.3
    assert np.nanstd(error) > 1.2 * np.nanstd(plain)


@pytest.mark.parametrize(("tilt_deg", "seen_at_all"), [(60.0, True), (79.0, False)])
def test_steep_surfaces_give_no_data(tilt_deg: float, seen_at_all: bool) -> None:
    cloud = render(plate(IDEAL, 350.0, tilt_deg), 1)
    assert bool(np.isfinite(cloud[195:205, 195:205]).any()) is seen_at_all


def test_no_point_is_steeper_than_the_limit() -> None:
    hits = trace(scene("shaft"))
    length = np.sqrt(1.0 + hits.u**2 + hits.v**2)
    facing = -(hits.normal[:, 0] * hits.u + hits.normal[:, 1] * hits.v + hits.normal[:, 2]) / length
    met = np.isfinite(hits.depth)
    assert (facing[met] > -1e-6).all()  # normals look at the camera
    valid = seen(hits, ScanErrors(), facing)
    assert np.degrees(np.arccos(facing[valid])).max() <= 75.0
    assert (facing[met] < np.cos(np.radians(75.0))).any()


def test_a_mirror_blinds_where_it_reflects_the_projector_into_an_eye() -> None:
    """On a plate square to the camera these are the spots half way to the eyes."""
    state = plate(replace(IDEAL, glare_deg=1.0))
    cloud = render(state, 1)
    blind = np.argwhere(~np.isfinite(cloud[100:300, 100:300, 2])) + 100
    x = (blind[:, 1] - 199.5) * 330.0 / 399.0
    y = (blind[:, 0] - 199.5) * 330.0 / 399.0
    assert blind.size > 0
    radius = 350.0 * np.tan(np.radians(1.0))
    off = np.minimum(np.hypot(x - 22.5, y), np.hypot(x + 22.5, y))
    assert off.max() < 1.1 * radius
    assert (off < 0.5 * radius).any()


def test_out_of_focus_is_not_measured() -> None:
    for depth_mm, within in ((270.0, False), (300.0, True), (420.0, True), (440.0, False)):
        assert bool(np.isfinite(render(plate(IDEAL, depth_mm), 1)).any()) is within


def test_same_seed_same_bits_and_another_seed_another_cloud() -> None:
    state = scene("rotor", points=90_000, errors=ScanErrors())
    first, again, other = render(state, 7), render(state, 7), render(state, 8)
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()
    assert first.dtype == np.float32
    assert first.shape == (300, 300, 3)


def test_every_strength_is_a_field() -> None:
    """Each number of the instrument changes the cloud."""
    state = scene("rotor", points=90_000, errors=ScanErrors())
    hits = trace(state)
    base = measured(hits, state.errors, np.random.default_rng(3)).tobytes()
    for entry in dataclasses.fields(ScanErrors):
        value = getattr(state.errors, entry.name)
        changed = replace(state.errors, **{entry.name: value + 1 if isinstance(value, int) else 1.3 * value + 0.01})
        assert measured(hits, changed, np.random.default_rng(3)).tobytes() != base, entry.name
