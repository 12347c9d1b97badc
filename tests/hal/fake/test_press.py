"""Press fit and faces."""

from __future__ import annotations

import numpy as np
import pytest

from hal.fake.contact.press import Faces, press_pressure_n_per_mm2, press_slope_n_per_mm
from tests.hal.fake.bench_plant import equal_joint


def test_pressure_of_two_thick_rings() -> None:
    # Lame with c = (R^2 + r^2) / (R^2 - r^2): 280/180 outside, 180/140 inside
    expected = (
        0.06 * 206_000.0 / (180.0 * ((280**2 + 180**2) / (280**2 - 180**2) + (180**2 + 140**2) / (180**2 - 140**2)))
    )
    assert press_pressure_n_per_mm2(equal_joint(), 0.06, 206_000.0) == pytest.approx(expected)
    assert press_pressure_n_per_mm2(equal_joint(), -0.01, 206_000.0) == 0.0


def test_force_grows_with_interference_and_friction() -> None:
    slope = press_slope_n_per_mm(equal_joint(), 0.06, 206_000.0, 0.15)
    assert press_slope_n_per_mm(equal_joint(), 0.12, 206_000.0, 0.15) == pytest.approx(2.0 * slope)
    assert press_slope_n_per_mm(equal_joint(), 0.06, 206_000.0, 0.30) == pytest.approx(2.0 * slope)


def test_faces_touch_at_the_rim_and_align_with_a_moment() -> None:
    faces = Faces(tilt_rad=4e-4, radius_mm=140.0, stiffness_nmm_per_rad=3e7)
    assert faces.touch_gap_mm == pytest.approx(0.056)
    assert faces.force_n(np.array([0.1, 0.056])) == pytest.approx([0.0, 0.0])
    # Flat: k tau at the lever R
    assert faces.force_n(np.array([0.0])) == pytest.approx([3e7 * 4e-4 / 140.0])
    assert [faces.share_of_tilt(gap) for gap in (1.0, 0.028, 0.0)] == pytest.approx([1.0, 0.5, 0.0])
    assert Faces(0.0, 140.0, 3e7).share_of_tilt(0.0) == 1.0
