"""Derivatives of the distance models, and frames turned upright."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision.fit import models
from cellctl.vision.fit.elements import CIRCLE, CONE, CYLINDER, SPHERE
from cellctl.vision.fit.search import Shape, upright
from tests.vision.fit.reference import Array, orientation

SHAPES = [SPHERE, CIRCLE, CYLINDER, CONE]


def elements(shape: Shape, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Points (count, 20, 3) and parameters (count, p) of some elements."""
    size = {"sphere": 4, "cylinder": 5}.get(shape.name, 6)
    x = rng.uniform(-0.5, 0.5, (count, size))
    x[:, -1] += 1.0 if shape.name != "cone" else 0.0
    return rng.standard_normal((count, 20, 3)), x


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
def test_jacobian_is_the_derivative_of_the_residuals(shape: Shape) -> None:
    points, x = elements(shape, np.random.default_rng(1), 5)
    _, jacobian = shape.model(points, x)
    step = 1e-6
    for i in range(x.shape[1]):
        shift = step * np.eye(x.shape[1])[i]
        slope = (shape.model(points, x + shift)[0] - shape.model(points, x - shift)[0]) / (2.0 * step)
        assert jacobian[..., i] == pytest.approx(slope, abs=1e-7)


def test_circle_in_the_plane_is_a_sphere_of_two_dimensions() -> None:
    points = np.array([[3.0, 4.0], [0.0, 2.0]])
    residuals, jacobian = models.sphere(points, np.array([0.0, 0.0, 2.0]))
    assert residuals == pytest.approx([3.0, 0.0])
    assert jacobian == pytest.approx(np.array([[-0.6, -0.8, -1.0], [0.0, -1.0, -1.0]]))


@pytest.mark.parametrize("shape", SHAPES[1:], ids=lambda shape: shape.name)
def test_an_element_in_its_upright_frame_is_the_same(shape: Shape) -> None:
    rng = np.random.default_rng(2)
    points, x = elements(shape, rng, 4)
    frames = np.stack([orientation(rng) for _ in range(4)])
    turned, y = upright(shape, frames, x)
    before = shape.model(points @ np.swapaxes(frames, 1, 2), x)[0]
    after = shape.model(points @ np.swapaxes(turned, 1, 2), y)[0]
    assert after == pytest.approx(before, abs=1e-12)
    assert np.all(y[:, 2:4] == 0.0)


def test_a_cone_turned_inside_out_is_told_as_the_usual_one() -> None:
    points, x = elements(CONE, np.random.default_rng(3), 4)
    frames = np.broadcast_to(np.eye(3), (4, 3, 3))
    inside_out = x * [1.0, 1.0, 0.0, 0.0, -1.0, 1.0] + [0.0, 0.0, 0.0, 0.0, 0.0, np.pi]
    turned, y = upright(CONE, frames, inside_out)
    assert np.all(np.abs(y[:, 5]) <= 0.5 * np.pi)
    before = CONE.model(points, inside_out)[0]
    assert CONE.model(points @ np.swapaxes(turned, 1, 2), y)[0] == pytest.approx(-before, abs=1e-12)
