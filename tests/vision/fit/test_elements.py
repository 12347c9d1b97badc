"""Every element against point sets whose exact least-squares solution is known: 0.1 um and 0.1 urad."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.vision import fit
from cellctl.vision.fit import Element
from tests.vision.fit import reference
from tests.vision.fit.reference import Array, Known

SETS = 40
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


def test_nearly_a_cylinder_is_still_a_cone() -> None:
    """Through an apex angle of zero nothing jumps: the radius is the cylinder's."""
    rng = np.random.default_rng(12)
    truth = reference.axial(rng, "cylinder", 1e-3)
    cone, cylinder = fit.cone(truth.points), fit.cylinder(truth.points)
    assert cone.apex_angle_deg == pytest.approx(0.0, abs=0.05)
    assert cone.radius_mm == pytest.approx(cylinder.radius_mm, abs=1e-2)


@pytest.mark.parametrize("kind", ["circle", "cylinder", "cone"])
def test_the_frame_of_the_points_does_not_matter(kind: str) -> None:
    rng = np.random.default_rng(21)
    truth = reference.circle(rng, 0.01) if kind == "circle" else reference.axial(rng, kind, 0.01)
    turn, shift = reference.orientation(rng), np.array([120.0, -300.0, 80.0])
    here, there = getattr(fit, kind)(truth.points), getattr(fit, kind)(truth.points @ turn + shift)
    assert there.point_mm == pytest.approx(here.point_mm @ turn + shift, abs=1e-8)
    assert angle_between(there.direction, here.direction @ turn) < 1e-10
    assert there.radius_mm == pytest.approx(here.radius_mm, abs=1e-8)
