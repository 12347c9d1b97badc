"""Forces while the studs enter, against analytic cases."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.contact import ContactModel, entry_forces, lateral_forces

MODEL = ContactModel()
COUNT = 36
ANGLES = np.arange(COUNT) * 2 * np.pi / COUNT
POINTS = 120.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
JACOBIAN = np.zeros((COUNT, 2, 3))
JACOBIAN[:, 0, 0] = JACOBIAN[:, 1, 1] = 1.0
JACOBIAN[:, 0, 2], JACOBIAN[:, 1, 2] = -POINTS[:, 1], POINTS[:, 0]
ROOM = np.full(COUNT, 0.15)


def test_studs_that_enter_at_once_all_wedge() -> None:
    offsets = np.random.default_rng(1).normal(0, 0.08, (5, COUNT, 2))
    axial, total = entry_forces(offsets, JACOBIAN, ROOM, np.zeros(COUNT), MODEL)
    lateral = lateral_forces(offsets, JACOBIAN, ROOM, MODEL)
    np.testing.assert_allclose(axial, lateral * MODEL.axial_per_lateral)
    np.testing.assert_allclose(total, axial.sum(axis=1))


def test_studs_that_enter_one_after_the_other_never_all_wedge() -> None:
    """A tilt of 0.02 degrees over the circle: a common shift is carried by the first to enter, scatter by fewer."""
    lag = 120.0 * np.radians(0.02) * (1.0 + np.cos(ANGLES))
    shift = np.tile([[0.17, 0.0]], (1, COUNT, 1))
    at_once = entry_forces(shift, JACOBIAN, ROOM, np.zeros(COUNT), MODEL)[1]
    assert entry_forces(shift, JACOBIAN, ROOM, lag, MODEL)[1] == pytest.approx(at_once, rel=0.02)
    assert entry_forces(0.5 * shift, JACOBIAN, ROOM, lag, MODEL)[1] == 0.0
    scatter = np.random.default_rng(2).normal(0, 0.08, (50, COUNT, 2))
    at_once = entry_forces(scatter, JACOBIAN, ROOM, np.zeros(COUNT), MODEL)[1].mean()
    assert 0.3 * at_once < entry_forces(scatter, JACOBIAN, ROOM, lag, MODEL)[1].mean() < 0.9 * at_once


def test_one_lone_stud_wedges_whenever_it_enters() -> None:
    offsets = np.zeros((1, COUNT, 2))
    offsets[0, 7] = 0.2 * np.array([np.cos(ANGLES[7]), np.sin(ANGLES[7])])
    for late in (0.0, 0.3):
        lag = np.linspace(0.0, 0.1, COUNT)
        lag[7] = late
        axial, total = entry_forces(offsets, JACOBIAN, ROOM, lag, MODEL)
        lateral = 0.05 / (1 / MODEL.lateral_n_per_mm + 1 / MODEL.stud_n_per_mm)
        assert axial[0, 7] == pytest.approx(lateral * MODEL.axial_per_lateral, rel=1e-3)
        assert total[0] == pytest.approx(axial[0, 7])
