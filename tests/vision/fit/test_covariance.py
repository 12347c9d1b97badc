"""Covariances: the exact derivative of the fit by its points, and errors under noise against what they say."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision import fit
from tests.vision.fit import minima, sets, spread

ELEMENTS = ["line", "plane", "circle", "sphere", "cylinder", "cone"]


@pytest.mark.parametrize("kind", ELEMENTS)
def test_covariance_is_that_of_the_fit_as_a_function_of_its_points(kind: str) -> None:
    """Variance of the residuals times G G^T, with G the fit's derivative by every coordinate, taken by differences."""
    rng = np.random.default_rng([5, ELEMENTS.index(kind)])
    points = sets.draw(kind, rng, exact=True).points
    while len(points) > 12:
        points = sets.draw(kind, rng, exact=True).points
    points = points + 1e-7 * np.ptp(points, axis=0).max() * rng.standard_normal(points.shape)
    found = getattr(fit, kind)(points)
    columns, step = [], 1e-6 * float(np.ptp(points, axis=0).max())
    for shift in step * np.eye(points.size).reshape(-1, *points.shape):
        ahead, behind = getattr(fit, kind)(points + shift), getattr(fit, kind)(points - shift)
        columns.append((spread.difference(ahead, found) - spread.difference(behind, found)) / (2.0 * step))
    derivative = np.array(columns).T
    degrees = len(points) * (2 if kind in ("line", "circle") else 1) - minima.SHAPES[kind]
    variance = minima.sum_of_squares(kind, points, minima.guess_of(found)) / degrees
    told = found.covariance / variance
    size = np.sqrt(np.diag(told)) + 1e-6 * np.sqrt(np.diag(told)).max()
    assert derivative @ derivative.T / np.outer(size, size) == pytest.approx(told / np.outer(size, size), abs=1e-3)


@pytest.mark.parametrize(("kind", "count"), [("line", 300), ("plane", 300), ("sphere", 150), ("cylinder", 40)])
def test_errors_are_as_large_as_told(kind: str, count: int) -> None:
    drawn = [spread.ratios(kind, np.random.default_rng([6, number])) for number in range(count)]
    for name in drawn[0]:
        mean = float(np.mean([one[name] for one in drawn if one]))
        assert mean == pytest.approx(1.0, abs=4.0 / np.sqrt(count)), name


def test_parameters_name_what_the_covariance_is_of() -> None:
    points = sets.draw("cone", np.random.default_rng(3), exact=True).points
    found = fit.cone(points)
    assert found.covariance is not None
    assert found.covariance.shape == (len(found.parameters),) * 2 == (8, 8)
    assert found.parameters[0] == "point_x_mm"
    assert found.parameters[-1] == "apex_angle_deg"
