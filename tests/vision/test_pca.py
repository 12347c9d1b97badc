"""Principal components: fixed signs, exact projections, refused input."""

import numpy as np
import pytest

from cellctl.vision.part import Refused
from cellctl.vision.pca import principal


def rod(generator: np.random.Generator) -> np.ndarray:
    return generator.normal(0, 1, (500, 3)) * [10.0, 3.0, 1.0] + [100.0, -20.0, 350.0]


def test_axes_and_variances_of_a_known_ellipsoid() -> None:
    parts = principal(rod(np.random.default_rng(1)))
    np.testing.assert_allclose(np.abs(parts.axes), np.eye(3), atol=0.1)
    np.testing.assert_allclose(np.sqrt(parts.variances_mm2), [10.0, 3.0, 1.0], rtol=0.1)
    assert np.linalg.det(parts.axes) == pytest.approx(1.0)


def test_signs_do_not_depend_on_the_order_or_the_direction_of_the_points() -> None:
    points = rod(np.random.default_rng(2))
    shuffled = principal(points[::-1])
    np.testing.assert_allclose(principal(points).axes, shuffled.axes, atol=1e-9)
    mirrored = principal(2 * points.mean(axis=0) - points)
    np.testing.assert_allclose(principal(points).axes, mirrored.axes, atol=1e-9)


def test_the_three_projections_are_of_the_centred_points() -> None:
    points = rod(np.random.default_rng(3))
    parts = principal(points)
    scores = parts.scores(points)
    np.testing.assert_allclose(scores.mean(axis=0), 0.0, atol=1e-9)
    for dropped, kept in ((0, [1, 2]), (1, [0, 2]), (2, [0, 1])):
        np.testing.assert_allclose(parts.projection(points, dropped), scores[:, kept], atol=1e-12)


def test_too_few_and_not_finite_are_refused() -> None:
    with pytest.raises(Refused, match="too_few_points"):
        principal(np.zeros((2, 3)))
    with pytest.raises(Refused, match="not_finite"):
        principal(np.array([[0.0, 0, 0], [1, 0, np.nan], [0, 1, 0]]))
