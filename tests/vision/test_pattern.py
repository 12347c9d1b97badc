"""The pattern found among candidates without a prior pose, and fitted to centres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellctl.vision.part import Part, Refused
from cellctl.vision.pattern import find_pattern, find_patterns, fit_pattern, nominal, symmetry
from tests.vision.parts import FLANGE, SHAFT


def placed(part: Part, centre: tuple[float, float], theta: float) -> np.ndarray:
    c, s = np.cos(theta), np.sin(theta)
    return nominal(part) @ np.array([[c, s], [-s, c]]) + centre


def radii(part: Part) -> np.ndarray:
    return 0.5 * np.asarray(part.diameter_mm)


@pytest.mark.parametrize(
    ("part", "order"),
    [
        (SHAFT, 36),
        (FLANGE, 1),
        (replace(SHAFT, diameter_mm=(9.0,) + (8.3,) * 35), 1),
        (replace(SHAFT, diameter_mm=(9.0, 8.3, 8.3) * 12), 12),
        (replace(SHAFT, angles_deg=(0.0, 120.0, 240.0), diameter_mm=None), 3),
        (replace(SHAFT, angles_deg=(0.0, -120.0, -240.0), diameter_mm=None), 3),
        (replace(SHAFT, angles_deg=(0.0, 90.0, 180.0, 271.0), diameter_mm=None), 1),
    ],
)
def test_symmetry(part: Part, order: int) -> None:
    assert symmetry(part) == order


def test_found_among_strays_for_any_pose() -> None:
    rng = np.random.default_rng(1)
    for part in (FLANGE, SHAFT):
        for _ in range(25):
            centre, theta = tuple(rng.uniform(-30, 30, 2)), float(rng.uniform(-np.pi, np.pi))
            places = placed(part, centre, theta) + rng.normal(0, 0.1, (part.count, 2))
            lost = rng.permutation(part.count)[: part.count // 5]
            candidates = np.vstack([np.delete(places, lost, axis=0), rng.uniform(-150, 150, (12, 2))])
            sizes = np.append(np.delete(radii(part), lost), rng.uniform(3, 7, 12))
            found = find_pattern(part, candidates, sizes, np.ones(len(sizes)), 1.2)
            assert found is not None
            assert np.hypot(*(found.centre_mm - centre)) < 0.5
            step = 2 * np.pi / symmetry(part)
            assert abs((found.clocking_rad - theta + step / 2) % step - step / 2) < 0.02
            assert abs(found.clocking_rad) <= step / 2 + 1e-9


def test_index_by_diameter_alone() -> None:
    part = replace(SHAFT, diameter_mm=(10.4,) + (8.3,) * 35, index_feature=0)
    found = find_pattern(part, placed(part, (3.0, 4.0), 2.0), radii(part), np.ones(36), 1.5)
    assert found is not None and found.clocking_rad == pytest.approx(2.0, abs=0.01)


def test_an_index_that_does_not_show_is_ambiguous() -> None:
    part = replace(SHAFT, diameter_mm=(10.4,) + (8.3,) * 35, index_feature=0)
    with pytest.raises(Refused, match="pattern_ambiguous"):
        find_pattern(part, placed(part, (3.0, 4.0), 2.0), np.full(36, 4.15), np.ones(36), 1.5)


def test_no_pattern_no_pose() -> None:
    rng = np.random.default_rng(2)
    found = find_pattern(SHAFT, rng.uniform(-140, 140, (15, 2)), np.full(15, 4.2), np.ones(15), 1.0)
    assert found is None or found.matched < 12


def test_fit_is_exact_without_noise_and_its_covariance_honest_with() -> None:
    exact = fit_pattern(FLANGE, placed(FLANGE, (0.3, -0.2), 0.01), np.tile(1e-6 * np.eye(2), (7, 1, 1)), 0.0)
    assert np.allclose([*exact.centre_mm, exact.clocking_rad], [0.3, -0.2, 0.01], atol=1e-12)
    rng, errors = np.random.default_rng(4), []
    covariances = np.tile(0.003**2 * np.eye(2), (36, 1, 1))
    for _ in range(300):
        noisy = placed(SHAFT, (0.1, 0.2), 0.002) + rng.normal(0, 0.003, (36, 2)) + rng.normal(0, 0.01, (36, 2))
        fitted = fit_pattern(SHAFT, noisy, covariances, 0.0)
        error = np.array([*(fitted.centre_mm - [0.1, 0.2]), fitted.clocking_rad - 0.002])
        errors.append(error @ np.linalg.inv(fitted.covariance) @ error / 3)
    assert 0.85 < np.mean(errors) < 1.25


@pytest.mark.parametrize("count", [3, 4, 6, 12])
def test_a_few_features_do_not_make_the_covariance_too_sure(count: int) -> None:
    part = replace(SHAFT, angles_deg=tuple(360.0 * i / count for i in range(count)), diameter_mm=None)
    rng, ratios = np.random.default_rng(5), []
    for _ in range(400):
        noisy = nominal(part) + rng.normal(0, np.hypot(0.004, 0.01), (count, 2))
        fitted = fit_pattern(part, noisy, np.tile(0.004**2 * np.eye(2), (count, 1, 1)), 0.0)
        error = np.array([*fitted.centre_mm, fitted.clocking_rad])
        ratios.append(error @ np.linalg.inv(fitted.covariance) @ error / 3)
    assert 0.7 < np.mean(ratios) < 1.3


def test_circle_diameter_is_measured() -> None:
    scaled = placed(FLANGE, (0.0, 0.0), 0.0) * 1.001
    fitted = fit_pattern(FLANGE, scaled, np.tile(1e-6 * np.eye(2), (7, 1, 1)), 0.0)
    assert fitted.diameter_mm == pytest.approx(150.15, abs=0.02)


@pytest.mark.parametrize("scatter_mm", [0.0, 0.1])
def test_the_circle_is_as_sure_as_it_says(scatter_mm: float) -> None:
    """Centres that are known unequally well, on places as drawn and on places that scatter beyond that.

    Its own error is among the scatter that it is judged by: it claims a little less than it knows.
    """
    rng = np.random.default_rng(6)
    part = replace(SHAFT, angles_deg=(0.0, 45.0, 135.0, 225.0, 315.0), diameter_mm=None)
    off = []
    for _ in range(400):
        own = rng.uniform(0.03, 0.1, 5)
        noise = np.hypot(own, scatter_mm)[:, None] * rng.standard_normal((5, 2))
        fitted = fit_pattern(part, nominal(part) + noise, own[:, None, None] ** 2 * np.eye(2), 0.0)
        off.append((fitted.diameter_mm - part.circle_diameter_mm) / fitted.sigma_diameter_mm)
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.1


def test_missing_features_are_left_out_and_two_are_too_few() -> None:
    places = placed(FLANGE, (1.0, 2.0), 0.1)
    places[[1, 4]] = np.nan
    fitted = fit_pattern(FLANGE, places, np.tile(1e-6 * np.eye(2), (7, 1, 1)), 0.1)
    assert np.allclose(fitted.centre_mm, [1, 2]) and np.isnan(fitted.residuals_mm[[1, 4]]).all()
    places[2:] = np.nan
    with pytest.raises(Refused, match="features_missing"):
        fit_pattern(FLANGE, places, np.tile(np.eye(2), (7, 1, 1)), 0.1)


def test_one_centre_far_off_neither_turns_nor_widens_the_pattern() -> None:
    part = replace(FLANGE, angles_deg=(0.0, 45.0, 135.0, 225.0, 315.0), diameter_mm=None)
    covariances = np.tile(0.03**2 * np.eye(2), (5, 1, 1))
    turned, widened = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        centres = nominal(part) + rng.normal(0.0, 0.03, (5, 2))
        off = centres.copy()
        angle = rng.uniform(0.0, 2.0 * np.pi)
        off[rng.integers(5)] += 0.6 * np.array([np.cos(angle), np.sin(angle)])
        right, wrong = fit_pattern(part, centres, covariances, 0.0), fit_pattern(part, off, covariances, 0.0)
        turned.append(wrong.clocking_rad - right.clocking_rad)
        widened.append(wrong.diameter_mm - right.diameter_mm)
    # plain least squares lets a fifth of 0.6 mm through: 0.085 mm rms on the circle, 0.17 mm in diameter
    assert np.sqrt(np.mean(np.square(turned))) * 75.0 < 0.05
    assert np.sqrt(np.mean(np.square(widened))) < 0.1


def test_a_centre_counts_little_along_the_direction_in_which_it_is_unsure() -> None:
    part = replace(FLANGE, angles_deg=(0.0, 90.0, 180.0, 270.0), diameter_mm=None)
    covariances = np.tile(0.01**2 * np.eye(2), (4, 1, 1))
    covariances[0] = np.diag([0.01**2, 0.2**2])  # unsure along the circle
    along, across = nominal(part), nominal(part)
    along[0, 1] += 0.012
    across[0, 0] += 0.012
    assert abs(fit_pattern(part, along, covariances, 0.0).clocking_rad) * 75.0 < 0.0003
    assert fit_pattern(part, across, covariances, 0.0).centre_mm[0] > 0.002


def test_rivals_are_told_best_first() -> None:
    part = replace(FLANGE, angles_deg=(0.0, 45.0, 135.0, 225.0, 315.0), diameter_mm=None)
    places = np.vstack([placed(part, (3.0, -2.0), 0.3), placed(part, (3.0, -2.0), 0.3 + 0.5 * np.pi)[:1]])
    weights = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.7])
    poses = find_patterns(part, places, np.full(6, 5.0), weights, 1.0, within=1.0)
    assert [round(np.degrees(pose.clocking_rad - 0.3)) % 360 for pose in poses[:2]] == [0, 90]
    assert poses[0].score > poses[1].score + 0.2
    best = find_pattern(part, places, np.full(6, 5.0), weights, 1.0)
    assert best is not None and best.clocking_rad == poses[0].clocking_rad
