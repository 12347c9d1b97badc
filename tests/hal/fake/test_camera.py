"""Pixel windows: every pixel of a box and hardly any other, boxes apart, nothing outside the image."""

from __future__ import annotations

import numpy as np
import pytest

from hal.fake.scene.camera import Camera, camera_for


def test_windows_hold_every_pixel_of_their_boxes() -> None:
    camera = Camera(rows=120, cols=90)
    u, v = camera.slopes()
    rng = np.random.default_rng(1)
    low = rng.uniform(-0.6, 0.5, (40, 2))
    high = low + rng.uniform(0.0, 0.2, (40, 2))
    pixels, boxes = camera.windows(low, high)
    for box in range(40):
        here = set(pixels[boxes == box].tolist())
        wanted = (u >= low[box, 0]) & (u <= high[box, 0]) & (v >= low[box, 1]) & (v <= high[box, 1])
        near = 3.5 * camera.pitch
        allowed = (u >= low[box, 0] - near) & (u <= high[box, 0] + near)
        allowed &= (v >= low[box, 1] - near) & (v <= high[box, 1] + near)
        assert set(np.flatnonzero(wanted).tolist()) <= here <= set(np.flatnonzero(allowed).tolist())


def test_a_box_outside_the_image_has_no_pixels() -> None:
    pixels, boxes = camera_for(10_000).windows(np.array([[0.8, 0.0]]), np.array([[0.9, 0.1]]))
    assert pixels.size == boxes.size == 0


def test_the_view_is_as_wide_whatever_the_number_of_points() -> None:
    for points in (10_000, 2_000_000):
        u, v = camera_for(points).slopes()
        assert u.max() * 350.0 == pytest.approx(165.0)
        assert v.min() * 350.0 == pytest.approx(-165.0)
