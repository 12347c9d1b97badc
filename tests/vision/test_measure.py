"""A whole part: pose, frames, quality, and every refusal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellctl.vision.geometry import inverse, pose, transform
from cellctl.vision.measure import Gates, measure_part
from cellctl.vision.part import PartMeasurement, Refused
from tests.vision.fit.reference import orientation
from tests.vision.parts import FLANGE, SHAFT
from tests.vision.synthetic import View, pose_above, render
from tests.vision.test_holes import view_of


def pose_error(view: View, measured: PartMeasurement) -> np.ndarray:
    """(6,) x, y, z in mm and rotation in rad of the measured pose in the true part frame."""
    delta = inverse(view.T_scanner_part) @ measured.T_frame_part
    rotation = delta[:3, :3]
    return np.append(delta[:3, 3], [rotation[2, 1], rotation[0, 2], rotation[1, 0]])


def test_pose_is_true_and_its_covariance_honest() -> None:
    distances = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        view = view_of(SHAFT, rng, 350)
        measured = measure_part(render(view, rng), SHAFT)
        error = pose_error(view, measured)
        assert np.abs(error[:3]).max() < 0.01 and np.abs(error[3:]).max() < 1e-4
        distances.append(error @ np.linalg.solve(measured.covariance, error) / 6)
        assert measured.circle_diameter_mm == pytest.approx(240.0, abs=0.015)
        assert measured.clocking_free and measured.frame == "input"
    assert 0.6 < np.mean(distances) < 1.7


def test_cell_frame_is_the_carried_scanner_frame() -> None:
    rng = np.random.default_rng(3)
    view = replace(view_of(FLANGE, rng, 300), field_mm=230.0)
    cloud = render(view, rng)
    T = pose(orientation(rng), np.array([10.0, -20.0, 350.0]))
    here, there = measure_part(cloud, FLANGE), measure_part(cloud, FLANGE, T)
    assert there.frame == "cell"
    assert np.allclose(there.T_frame_part, T @ here.T_frame_part, atol=1e-9)
    for a, b in zip(here.features, there.features, strict=True):
        assert a.center_mm is not None and b.center_mm is not None
        assert a.covariance_mm2 is not None and b.covariance_mm2 is not None
        assert np.allclose(transform(T, a.center_mm), b.center_mm, atol=1e-9)
        assert np.allclose(T[:3, :3] @ a.covariance_mm2 @ T[:3, :3].T, b.covariance_mm2)
    assert np.allclose(T[:3, :3] @ here.face.normal, there.face.normal)


def test_cloud_already_in_another_frame() -> None:
    """An organised cloud says where its camera stood, so the normal points the right way in any frame."""
    rng = np.random.default_rng(4)
    view = replace(view_of(FLANGE, rng, 300), field_mm=230.0)
    T = pose(orientation(rng), np.array([10.0, -20.0, -900.0]))
    moved = transform(T, render(view, rng).astype(np.float64))
    measured = measure_part(moved, FLANGE)
    assert measured.face.normal @ (T @ view.T_scanner_part)[:3, 2] > 0.9999
    assert np.linalg.norm(measured.T_frame_part[:3, 3] - (T @ view.T_scanner_part)[:3, 3]) < 0.02


def test_unorganised_cloud() -> None:
    rng = np.random.default_rng(5)
    view = view_of(SHAFT, rng, 500)
    grid = render(view, rng)
    loose = grid[np.isfinite(grid[..., 0])]
    measured = measure_part(loose[rng.permutation(len(loose))], SHAFT)
    assert measured.found == 36
    assert np.abs(pose_error(view, measured)[:3]).max() < 0.01


def test_same_cloud_same_bits() -> None:
    rng = np.random.default_rng(6)
    cloud = render(view_of(FLANGE, rng, 250), rng)
    first, second = measure_part(cloud, FLANGE, seed=5), measure_part(cloud, FLANGE, seed=5)
    assert np.array_equal(first.T_frame_part, second.T_frame_part)
    assert np.array_equal(first.covariance, second.covariance)
    assert first.quality == second.quality


def test_quality_tells_what_was_seen() -> None:
    rng = np.random.default_rng(7)
    view = view_of(SHAFT, rng, 400)
    quality = measure_part(render(view, rng), SHAFT).quality
    assert quality["coverage"] > 0.95
    assert quality["distance_mm"] == pytest.approx(view.T_scanner_part[2, 3], abs=2.0)
    assert quality["spacing_mm"] == pytest.approx(320.0 / 400, rel=0.1)
    assert quality["found"] == 36


def refusal(cloud: np.ndarray, part=SHAFT, **values: object) -> str:  # type: ignore[no-untyped-def]
    with pytest.raises(Refused) as refused:
        measure_part(cloud, part, **values)  # type: ignore[arg-type]
    assert len(refused.value.reason) > 10
    return refused.value.code


def test_refusals() -> None:
    rng = np.random.default_rng(8)
    view = view_of(SHAFT, rng, 300)
    cloud = render(view, rng)
    assert refusal(cloud, gates=Gates(distance_low_mm=400.0, distance_high_mm=500.0)) == "out_of_range"
    assert refusal(cloud / 1000.0) == "wrong_unit"
    assert refusal(np.where(rng.random(cloud.shape) < 1e-4, np.inf, cloud)) == "not_finite"
    assert refusal(np.full_like(cloud, np.nan)) == "too_few_points"
    assert refusal(rng.uniform(-100, 100, (20_000, 3))) in {"too_noisy", "face_not_found", "features_missing"}
    assert refusal(cloud[::6, ::6]) in {"too_coarse", "features_missing", "too_few_points"}
    assert refusal(cloud, gates=Gates(min_points_per_feature=100_000)) == "too_few_points"
    closed = render(replace(view, missing=tuple(range(36))), rng)
    assert refusal(closed) == "features_missing"
    half = cloud.copy()
    half[:, 110:] = np.nan
    assert refusal(half) in {"features_missing", "too_few_points"}


def test_the_wrong_part_is_refused() -> None:
    rng = np.random.default_rng(9)
    cloud = render(view_of(SHAFT, rng, 400), rng)
    for wrong in (
        replace(SHAFT, circle_diameter_mm=230.0),
        replace(SHAFT, angles_deg=tuple(11.25 * i for i in range(32)), diameter_mm=(8.3,) * 32),
    ):
        assert refusal(cloud, wrong) in {"features_missing", "wrong_part", "pattern_ambiguous"}


def test_a_warped_face_is_refused() -> None:
    rng = np.random.default_rng(10)
    view = replace(view_of(SHAFT, rng, 400), T_scanner_part=pose_above(350.0))
    cloud = render(view, rng).astype(np.float64)
    cloud *= (1.0 + 0.001 * (cloud[..., 0] / 140.0) ** 2)[..., None]
    assert refusal(cloud) in {"face_warped", "features_missing", "face_not_found"}


def test_outlier_removal_is_an_option_that_does_no_harm() -> None:
    rng = np.random.default_rng(11)
    view = replace(view_of(FLANGE, rng, 250), field_mm=230.0)
    cloud = render(view, rng)
    measured = measure_part(cloud, FLANGE, gates=Gates(outlier_removal="one_sided"))
    assert measured.found == 7
    assert np.abs(pose_error(view, measured)[:3]).max() < 0.02
