"""Points that do not determine an element are refused with a reason; nothing crashes and nothing is guessed."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision import fit
from cellctl.vision.fit import FitError
from tests.vision.fit.reference import Array, orientation

ALL = ["line", "plane", "circle", "sphere", "cylinder", "cone", "plane_zone", "circle_zone", "cylinder_zone"]
RNG = np.random.default_rng(31)
TURN = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
FRAME = orientation(RNG)
LINE = np.outer(np.arange(12.0), [1.0, 2.0, 3.0]) @ FRAME + 400.0
FLAT = np.column_stack([RNG.uniform(-9.0, 9.0, (15, 2)), np.zeros(15)]) @ FRAME + 300.0
RING = np.column_stack([5.0 * np.cos(TURN), 5.0 * np.sin(TURN), 0.0 * TURN]) @ FRAME + 100.0
RAILS = np.array([[x, y, 0.0] for x in range(8) for y in (0.0, 2.0)]) @ FRAME
BALL = RNG.standard_normal((20, 3))


@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.full((9, 3), np.nan), "not finite"),
        (np.vstack([BALL, [np.inf, 0.0, 0.0]]), "not finite"),
        (np.zeros((9, 2)), r"shape \(9, 2\)"),
        (np.zeros(9), r"shape \(9,\)"),
        (BALL[:1], "1 points, at least"),
        (np.ones((9, 3)), "in one place"),
        (1e200 * BALL, "spread over"),
        (1e-200 * BALL, "spread over"),
        (np.vstack([BALL, [1.7e308, 0.0, 0.0], [-1.7e308, 0.0, 0.0]]), "spread over"),
        (BALL + 1e12, "spread over"),
        ([["a", "b", "c"]] * 9, "not numbers"),
        ([[1.0, 2.0, 3.0], [4.0]], "not numbers"),
    ],
)
def test_what_is_no_set_of_points(kind: str, points: Array, reason: str) -> None:
    with pytest.raises(FitError, match=reason):
        getattr(fit, kind)(points)


@pytest.mark.parametrize("kind", ALL[1:])
def test_points_on_a_line(kind: str) -> None:
    with pytest.raises(FitError, match="on a line"):
        getattr(fit, kind)(LINE)


@pytest.mark.parametrize(
    ("kind", "points"),
    [
        ("line", RING),
        ("plane", np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])),
        ("sphere", FLAT),
        ("sphere", RING),
        ("cylinder", FLAT),
        ("cylinder", RING),
        ("cylinder", RAILS),
        ("cylinder", np.repeat(BALL[:4], 5, axis=0)),
        ("cone", FLAT),
        ("cone", RING),
        ("cone", np.repeat(BALL[:5], 5, axis=0)),
        ("circle_zone", RAILS),
        ("cylinder_zone", FLAT),
        ("cylinder_zone", RING),
        ("cylinder_zone", np.repeat(BALL[:4], 5, axis=0)),
    ],
)
def test_points_that_several_such_elements_hold(kind: str, points: Array) -> None:
    with pytest.raises(FitError, match=r"do not determine|no direction|no plane"):
        getattr(fit, kind)(points)


def test_a_nearly_flat_set_is_no_cylinder() -> None:
    """The flat band is narrower than any curved one, and no sum of squares is least."""
    rng = np.random.default_rng(32)
    points = np.column_stack([rng.uniform(-9.0, 9.0, (15, 2)), 1e-3 * rng.standard_normal(15)])
    with pytest.raises(FitError, match="cylinder"):
        fit.cylinder_zone(np.vstack([points, points * [1.0, 1.0, -1.0]]))
    with pytest.raises(FitError, match="cylinder"):
        fit.cylinder(np.vstack([points, points * [1.0, 1.0, -1.0]]))


@pytest.mark.parametrize("kind", ALL)
def test_other_numbers_than_float64_are_taken(kind: str) -> None:
    points = np.round(100.0 * (BALL if "line" not in kind else BALL * [5.0, 1.0, 1.0]))
    exact = getattr(fit, kind)(points)
    for same in (points.astype(int), points.astype(np.float32), points.tolist()):
        assert getattr(fit, kind)(same).zone_mm == exact.zone_mm
