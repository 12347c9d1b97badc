"""Every element against point sets whose exact least-squares solution is known: 0.1 um and 0.1 urad."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision import fit
from cellctl.vision.fit import Element, FitError
from tests.vision.fit import reference
from tests.vision.fit.reference import Array, Known

SETS = 60
LIMIT_MM = 1e-4
LIMIT_RAD = 1e-7


def known(kind: str, rng: np.random.Generator) -> Known:
    size = float(10.0 ** rng.uniform(-4.0, -1.7))
    if kind in ("cylinder", "cone"):
        return reference.axial(rng, kind, size)
    if kind in ("plane", "line"):
        return reference.flat(rng, kind, size)
    return reference.circle(rng, size) if kind == "circle" else reference.sphere(rng, size)


def angle_between(a: Array | None, b: Array) -> float:
    assert a is not None
    return float(np.linalg.norm(np.cross(a, b)))


def miss(kind: str, found: Element, truth: Known) -> tuple[float, float]:
    """Largest error in mm and in rad."""
    offset = found.point_mm - truth.point
    along = float(offset @ truth.direction)
    if kind == "sphere":
        return max(float(np.linalg.norm(offset)), abs((found.radius_mm or 0.0) - truth.radius)), 0.0
    turned = angle_between(found.direction, truth.direction)
    if kind == "circle":
        return max(float(np.linalg.norm(offset)), abs((found.radius_mm or 0.0) - truth.radius)), turned
    if kind == "plane":
        return abs(along), turned
    lateral = float(np.linalg.norm(offset - along * truth.direction))
    if kind == "line":
        return lateral, turned
    radius = truth.radius
    if kind == "cone":
        half = np.radians(truth.apex_deg / 2.0)
        radius += along * np.tan(half)
        turned = max(turned, abs(np.radians(found.apex_angle_deg or 0.0) - 2.0 * half))
    return max(lateral, abs((found.radius_mm or 0.0) - radius)), turned


@pytest.mark.parametrize("kind", ["line", "plane", "circle", "sphere", "cylinder", "cone"])
def test_known_minimum_is_met(kind: str) -> None:
    rng = np.random.default_rng(20_240)
    worst_mm = worst_rad = 0.0
    for _ in range(SETS):
        truth = known(kind, rng)
        found = getattr(fit, kind)(truth.points)
        error_mm, error_rad = miss(kind, found, truth)
        worst_mm, worst_rad = max(worst_mm, error_mm), max(worst_rad, error_rad)
    assert worst_mm < LIMIT_MM
    assert worst_rad < LIMIT_RAD


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["line", "plane", "circle", "sphere", "cylinder", "cone"])
def test_known_minimum_is_met_a_thousand_times(kind: str) -> None:
    rng = np.random.default_rng(7)
    misses = [miss(kind, getattr(fit, kind)(truth.points), truth) for truth in (known(kind, rng) for _ in range(1000))]
    assert max(item[0] for item in misses) < LIMIT_MM
    assert max(item[1] for item in misses) < LIMIT_RAD


@pytest.mark.parametrize("kind", ["circle", "sphere", "cylinder", "plane"])
def test_covariance_matches_the_scatter(kind: str) -> None:
    """Mean squared Mahalanobis distance of the position over repeated noise is about its dimension."""
    rng = np.random.default_rng(3)
    sigma, ratios = 0.01, []
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    height = rng.uniform(-20.0, 20.0, 40)
    shape = {
        "circle": np.column_stack([30 * np.cos(turn), 30 * np.sin(turn), 0 * turn]),
        "cylinder": np.column_stack([30 * np.cos(turn), 30 * np.sin(turn), height]),
        "plane": np.column_stack([30 * np.cos(turn), 20 * height, 0 * turn]),
        "sphere": 30.0 * np.column_stack([*_unit(rng, 40)]),
    }[kind]
    for _ in range(80):
        found = getattr(fit, kind)(shape + sigma * rng.standard_normal(shape.shape))
        assert found.covariance is not None
        error = found.point_mm - shape.mean(axis=0) if kind == "plane" else found.point_mm
        if kind == "plane":
            ratios.append(float(error[2] ** 2 / found.covariance[2, 2]))
        elif kind == "sphere":
            ratios.append(float(error @ np.linalg.inv(found.covariance[:3, :3]) @ error) / 3.0)
        else:
            ratios.append(float(error[:2] @ error[:2] / np.trace(found.covariance[:2, :2])))
    assert 0.75 < np.mean(ratios) < 1.35


def _unit(rng: np.random.Generator, count: int) -> Array:
    raw = rng.standard_normal((count, 3))
    return np.asarray((raw / np.linalg.norm(raw, axis=1, keepdims=True)).T)


def test_equal_data_give_equal_signs() -> None:
    rng = np.random.default_rng(5)
    truth = reference.axial(rng, "cylinder", 0.001)
    first, second = fit.cylinder(truth.points), fit.cylinder(truth.points[::-1].copy())
    assert first.direction is not None and second.direction is not None
    assert first.direction @ second.direction > 0.999999
    assert first.direction[np.argmax(np.abs(first.direction))] > 0.0


def test_cone_widens_along_its_direction() -> None:
    truth = reference.axial(np.random.default_rng(8), "cone", 1e-4)
    found = fit.cone(truth.points)
    assert found.direction is not None and found.direction @ truth.direction > 0.9999


@pytest.mark.parametrize(
    ("kind", "points"),
    [
        ("plane", np.column_stack([np.arange(9.0), np.arange(9.0), np.arange(9.0)])),
        ("circle", np.column_stack([np.arange(9.0), 0 * np.arange(9.0), 0 * np.arange(9.0)])),
        ("sphere", np.column_stack([np.cos(np.arange(9.0)), np.sin(np.arange(9.0)), np.zeros(9)])),
        ("cylinder", np.zeros((9, 3))),
        ("cone", np.full((9, 3), np.nan)),
        ("line", np.zeros((1, 3))),
        ("plane", np.zeros((4, 2))),
    ],
)
def test_points_that_do_not_determine_it_are_refused(kind: str, points: Array) -> None:
    with pytest.raises(FitError):
        getattr(fit, kind)(points)
