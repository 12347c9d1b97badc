"""Where to aim and how far the true best pose lies from there, against draws of what the bolts may be."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.docking.best_pose import aim, softness_mm, type_a
from cellctl.studies.calibration import nees
from cellctl.vision.match import polish
from cellctl.vision.uncertainty import Belief

COUNT, ROOM_MM, OWN_MM, RIGID_MM = 36, 0.15, 0.008, 0.003


def belief(offsets_mm: np.ndarray, own_mm: float, growth: float = 0.0) -> Belief:
    count = len(offsets_mm)
    angles = np.arange(count) * 2 * np.pi / count
    points = 120.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    jacobian = np.zeros((count, 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -points[:, 1], points[:, 0]
    return Belief(
        offsets_mm=offsets_mm[None],
        entering=np.ones(1, dtype=bool),
        lag_mm=np.zeros(count),
        growth_mm_per_k=growth * points,
        jacobian=jacobian,
        shared_mm=np.zeros((1, count, 2, 0)),
        own_mm=np.full((1, count, 1), own_mm),
        clearance_mm=np.full(count, ROOM_MM),
    )


def test_bolts_known_exactly_are_served_by_the_hard_minimax() -> None:
    offsets = np.random.default_rng(1).normal(0, 0.014, (COUNT, 2))
    exact = belief(offsets, 0.0)
    hard = polish(offsets, exact.jacobian, exact.clearance_mm)
    worst = [
        np.linalg.norm(offsets + exact.jacobian @ move, axis=1).max() for move in (aim(exact, 0.0), hard, np.zeros(3))
    ]
    assert worst[0] == pytest.approx(worst[1], abs=5e-6)
    assert worst[0] < worst[2]


def test_aiming_at_the_expected_worst_serves_the_true_worst_better_than_following_the_noise() -> None:
    rng = np.random.default_rng(2)
    soft, hard = [], []
    for _ in range(60):
        offsets = rng.normal(0, 0.012, (COUNT, 2))
        true = offsets + rng.normal(0, OWN_MM, (COUNT, 2))
        known = belief(offsets, OWN_MM)
        for move, into in ((aim(known, 0.0), soft), (polish(offsets, known.jacobian, known.clearance_mm), hard)):
            into.append(np.linalg.norm(true + known.jacobian @ move, axis=1).max())
    assert np.mean(soft) < np.mean(hard) - 2e-4


def test_the_hot_joint_counts_too() -> None:
    """A circle that grows off its centre: cold alone would leave the pose, hot asks for a shift."""
    offsets = np.zeros((COUNT, 2))
    offsets[0] = 0.02, 0.0
    assert abs(aim(belief(offsets, 0.0), 45.0)[0]) > 0.005  # no growth: half of the lone offset
    grown = belief(offsets, 0.0, growth=12.5e-6)
    move = aim(grown, 45.0)
    hot = grown.offsets_mm[0] + 45.0 * grown.growth_mm_per_k
    worst = [np.linalg.norm(hot + grown.jacobian @ m, axis=1).max() for m in (move, np.zeros(3))]
    assert worst[0] < worst[1] - 0.005


def test_type_a_is_the_scatter_of_the_true_best_pose_about_the_aim() -> None:
    rng = np.random.default_rng(3)
    errors, covariances = [], []
    for _ in range(120):
        offsets = rng.normal(0, 0.012, (COUNT, 2))
        known = belief(offsets, OWN_MM)
        move = aim(known, 0.0)
        there = belief(offsets + known.jacobian @ move, OWN_MM)
        measured = known.jacobian @ np.diag([RIGID_MM, RIGID_MM, RIGID_MM / 120.0])
        true = there.offsets_mm[0] + measured @ rng.normal(size=3) + rng.normal(0, OWN_MM, (COUNT, 2))
        errors.append(polish(true, known.jacobian, known.clearance_mm))
        covariances.append(type_a(there, measured, rng))
    assert 0.8 < nees(np.array(errors), np.array(covariances)).mean() < 1.25


def test_softness_goes_with_what_is_not_known_of_a_bolt() -> None:
    assert softness_mm(belief(np.zeros((COUNT, 2)), 0.0)) == 0.0
    assert softness_mm(belief(np.zeros((COUNT, 2)), 0.01)) == pytest.approx(0.0078, abs=1e-4)
