"""Table axis and stage from poses of a part: exact without noise, honest with it, refused where stops are too weak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellctl.calibrating.seen import Seen
from cellctl.calibrating.stage import stage_axes
from cellctl.calibrating.table import table_axis
from cellctl.kinematics import AxesPosition, rotation_about
from cellctl.studies.calibration import nees
from cellctl.vision.part import Refused

POINT = np.array([0.2, -0.1, 0.0])
DIRECTION = np.array([3e-4, -2e-4, 1.0]) / np.linalg.norm([3e-4, -2e-4, 1.0])
CENTRE = np.array([1.5, -2.0, 0.0])
NORMAL = np.array([2e-4, 4e-4, 1.0]) / np.linalg.norm([2e-4, 4e-4, 1.0])
SURE = (np.array([0.0, 0.0, 350.0]), np.zeros((6, 6)))
ANGLES = np.linspace(-165.0, 165.0, 12)
STEP = np.radians(10.0)


def turned(angles=ANGLES, generator: np.random.Generator | None = None) -> list[Seen]:
    """The part at each angle; the clocking is told up to a tenth of a turn, the encoder errs by 0.004 sin."""
    seen = []
    for angle in angles:
        spin = rotation_about(DIRECTION, np.radians(angle))
        centre, normal = POINT + spin @ (CENTRE - POINT), spin @ NORMAL
        if generator is not None:
            centre = centre + generator.normal(0.0, 0.003, 3)
            normal = normal + np.array([*generator.normal(0.0, 1e-5, 2), 0.0])
        true = np.radians(angle + 0.004 * np.sin(np.radians(angle)))
        seen.append(Seen(AxesPosition(0.0, 0.0, 0.0, float(angle)), centre, normal, float(true % STEP), STEP))
    return seen


def stepped(size: float = 8.0, scale: float = 1.0, askew: float = 1e-3) -> list[Seen]:
    places = [(x * size, 0.0) for x in (-1, 0, 1)] + [(0.0, y * size) for y in (-1, 0, 1)]
    x_direction, y_direction = np.array([1.0, askew, 0.0]), np.array([0.0, 1.0, 0.0])
    return [
        Seen(AxesPosition(x, y, 0.0, 0.0), CENTRE + scale * (x * x_direction + y * y_direction), NORMAL, 0.0, STEP)
        for x, y in places
    ]


def test_without_noise_the_axis_is_exact() -> None:
    found = table_axis(turned(), SURE, (0.0, 115.0))
    assert found.point_mm[:2] == pytest.approx(POINT[:2], abs=1e-6)
    assert found.direction == pytest.approx(DIRECTION, abs=1e-9)
    assert found.encoder_deg == pytest.approx(0.004 / np.sqrt(2.0), rel=1e-3)
    assert found.angle_deg < 1e-6


def test_errors_are_as_large_as_stated() -> None:
    errors, covariances = [], []
    for seed in range(200):
        found = table_axis(turned(generator=np.random.default_rng(seed)), SURE, (0.0, 115.0))
        x, y = np.degrees(found.direction[:2] - DIRECTION[:2])
        errors.append(np.array([*(found.point_mm - POINT)[:2], -y, x]))
        covariances.append(found.covariance)
    assert np.mean(nees(np.array(errors), np.array(covariances))) == pytest.approx(1.0, abs=0.15)


def test_the_views_own_error_and_the_ripple_go_with_the_axis() -> None:
    view = (SURE[0], np.diag([0.001, 0.001, 0.0, 0.0, 0.0, 0.0]) ** 2)
    found = table_axis(turned(), view, (0.0, 115.0))
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx([350.0 * np.radians(0.001)] * 2 + [0.001] * 2, rel=1e-3)
    wavy = table_axis(turned(), SURE, (0.01, 115.0))
    assert 0.001 < np.sqrt(wavy.covariance[2, 2]) < 0.005


def moved_in_the_chuck() -> list[Seen]:
    seen = turned()
    return seen[:6] + [replace(one, centre_mm=one.centre_mm + np.array([0.3, 0.0, 0.0])) for one in seen[6:]]


@pytest.mark.parametrize(
    ("seen", "code"),
    [
        (turned(ANGLES[:5]), "geometry_too_weak"),
        (turned(np.linspace(-30.0, 30.0, 12)), "geometry_too_weak"),
        (moved_in_the_chuck(), "residual_too_large"),
    ],
)
def test_refusals_of_the_table(seen: list[Seen], code: str) -> None:
    with pytest.raises(Refused) as refused:
        table_axis(seen, SURE, (0.0, 115.0))
    assert refused.value.code == code


def test_directions_and_squareness_of_the_stage() -> None:
    found = stage_axes(stepped(), np.zeros((6, 6)))
    assert found.x_direction == pytest.approx(np.array([1.0, 1e-3, 0.0]), abs=1e-6)
    assert found.square_deg == pytest.approx(np.degrees(1e-3), rel=1e-3)


@pytest.mark.parametrize(
    ("seen", "code"),
    [
        (stepped(size=1.0), "geometry_too_weak"),
        (stepped(scale=1.02), "wrong_unit"),
        (stepped()[:4], "geometry_too_weak"),
    ],
)
def test_refusals_of_the_stage(seen: list[Seen], code: str) -> None:
    with pytest.raises(Refused) as refused:
        stage_axes(seen, np.zeros((6, 6)))
    assert refused.value.code == code
