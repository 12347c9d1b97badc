"""Outlines of holes whose edges a camera has worn, all alike: what one hole has lost, the others know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellctl.vision.likeness import by_likeness
from cellctl.vision.outline import Outline, edge_band_mm, fit_outlines
from cellctl.vision.part import Part
from cellctl.vision.pattern import PatternPose, nominal

PART = Part("hole", 50.0, (0.0, 45.0, 135.0, 225.0, 315.0), index_feature=0, diameter_mm=(6.0, 5.0, 5.0, 5.0, 5.0))
RADII = np.array([3.3, 2.7, 2.7, 2.7, 2.7])
SPACING = 0.32


def worn(angle: np.ndarray) -> np.ndarray:
    """How far outside the drawn edge the face ends, by direction: notches and a side that is eaten away."""
    return 0.25 * np.cos(2 * angle + 0.7) - 0.5 * np.exp(
        -((np.mod(angle - 5.0 + np.pi, 2 * np.pi) - np.pi) ** 2) / 0.08
    )


def face(
    rng: np.random.Generator, centres: np.ndarray, radii: np.ndarray, torn: dict[int, tuple[float, float]]
) -> np.ndarray:
    """Points (M, 2) on a turned, jittered lattice; `torn` gives sectors (from, to) in which a hole has lost its rim."""
    steps = np.arange(-32.0, 32.0, SPACING)
    uv = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) + rng.normal(0.0, 0.03, (len(steps) ** 2, 2))
    turn = rng.uniform(0.0, np.pi)
    uv = uv @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    keep = np.ones(len(uv), dtype=np.bool_)
    for k, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        offset = uv - centre
        angle, distance = np.arctan2(offset[:, 1], offset[:, 0]), np.hypot(*offset.T)
        keep &= distance > radius + worn(angle)
        low, high = torn.get(k, (0.0, 0.0))
        keep &= (distance > radius + 1.2) | (np.mod(angle - low, 2 * np.pi) > high - low)
    return np.asarray(uv[keep])


def owned(uv: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    distance = np.hypot(*(uv[:, None] - places[None]).transpose(2, 0, 1))
    near = distance.min(axis=1) < 5.0
    return uv[near], distance.argmin(axis=1)[near]


def outlines(uv: np.ndarray, part: Part, radii: np.ndarray = RADII) -> list[Outline]:
    return fit_outlines(*owned(uv, nominal(part)), nominal(part), radii, SPACING, part)


def misses(found: list[Outline], centres: np.ndarray) -> np.ndarray:
    """(n, 2) errors but for what all have in common: edges that are worn on one side shift all centres."""
    error = np.array([one.centre_mm for one in found]) - centres
    return np.asarray(error - np.median(error, axis=0))


def test_a_torn_rim_is_completed_by_the_others() -> None:
    errors, chi = [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        centres = nominal(PART) + rng.normal(0.0, 0.03, (5, 2))
        low = rng.uniform(0.0, 2 * np.pi)
        found = outlines(face(rng, centres, RADII, {int(rng.integers(5)): (low, low + 2.2)}), PART)
        error = misses(found, centres)
        errors.append(error)
        chi += [e @ np.linalg.solve(one.covariance, e) / 2 for e, one in zip(error, found, strict=True)]
    assert np.sqrt(np.mean(np.square(errors))) < 0.1 * SPACING
    assert np.abs(errors).max() < 0.5 * SPACING
    assert np.mean(chi) < 1.5  # no surer than it is


def test_the_covariance_grows_along_the_side_that_is_missing() -> None:
    rng = np.random.default_rng(3)
    found = outlines(face(rng, nominal(PART), RADII, {2: (-1.3, 1.3)}), PART)
    torn, whole = found[2], found[3]
    assert torn.arc < 0.75 < whole.arc
    assert torn.covariance[0, 0] > 1.3 * torn.covariance[1, 1]
    assert np.trace(torn.covariance) > 1.3 * np.trace(whole.covariance)


@pytest.mark.parametrize("sizes", [PART.diameter_mm, (5.0,) * 5, None])
def test_holes_alike_share_a_radius_and_a_plainly_larger_one_keeps_its_own(sizes: tuple[float, ...] | None) -> None:
    found = outlines(face(np.random.default_rng(4), nominal(PART), RADII, {}), replace(PART, diameter_mm=sizes))
    radii = [one.radius_mm for one in found]
    assert len(set(radii[1:])) == 1
    assert radii[0] - radii[1] == pytest.approx(0.6, abs=0.1)


def test_a_closed_place_and_an_empty_one() -> None:
    rng = np.random.default_rng(5)
    drilled = np.delete(nominal(PART), 3, axis=0)
    uv = face(rng, drilled, np.delete(RADII, 3), {})
    uv = uv[np.hypot(*(uv - nominal(PART)[1]).T) > 6.0]
    found = outlines(uv, PART)
    assert found[3].fill > 0.9
    assert found[1].arc < 0.1 and found[1].fill < 0.1
    assert all(found[k].arc > 0.9 and found[k].fill < 0.1 for k in (0, 2, 4))


def test_voids_of_missing_points_are_no_holes() -> None:
    """A quarter turn meets as many voids: three holes' neighbours and a ragged patch where the key hole would be."""
    rng = np.random.default_rng(6)
    uv = face(rng, nominal(PART), RADII, {})
    offset = uv - [0.0, 25.0]
    ragged = 3.0 + 0.8 * np.sin(3.0 * np.arctan2(offset[:, 1], offset[:, 0]) + 0.5)
    uv = uv[np.hypot(*offset.T) > ragged]
    poses = [PatternPose(np.zeros(2), turn, 5, 4.0) for turn in (0.5 * np.pi, 0.0)]
    first, second = by_likeness(poses, uv, PART, np.tile(RADII, (2, 1)), SPACING)
    assert abs(first.clocking_rad) < 0.01 and first.score > second.score + 0.4


def test_a_pose_is_moved_to_its_outlines() -> None:
    uv = face(np.random.default_rng(7), nominal(PART), RADII, {}) + np.array([40.0, -30.0])
    off = PatternPose(np.array([40.4, -30.3]), 0.015, 5, 4.0)
    (moved,) = by_likeness([off], uv, PART, RADII[None], SPACING)
    assert abs(moved.clocking_rad) < 0.002
    assert moved.score > 3.5


def test_the_band_of_an_edge_follows_spacing_and_noise_within_limits() -> None:
    assert edge_band_mm(0.01, 0.2) == pytest.approx(0.5)
    assert edge_band_mm(0.2, 0.1) == pytest.approx(0.8)
    assert edge_band_mm(0.01, 2.0) == pytest.approx(1.0)
