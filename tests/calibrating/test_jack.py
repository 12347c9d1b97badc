"""The jack's line past a mandrel: the twin's own mandrel geometry, exact without noise, honest with it, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellctl.calibrating.jack import jack_line
from cellctl.calibrating.mandrel import Probed, centre_of
from cellctl.calibrating.table import TableAxis
from cellctl.kinematics import AxesPosition
from cellctl.studies.calibration import nees
from cellctl.vision.part import Refused
from hal.fake.fixtures import PROBES_MM, Mandrel, draw_mandrel
from hal.fake.frames import pose, rotation_z

STAGE = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
UPRIGHT = TableAxis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.zeros((4, 4)), 0.0, 0.0, 0.0, 0.0)
SLOPE = np.array([8e-4, -5e-4])
HEIGHTS = tuple(np.linspace(0.0, 400.0, 9))


def table(x: float, y: float, z: float, theta_deg: float, stray: float = 0.0):
    """Pose of the table on a jack that leans by `SLOPE` and strays by `stray` (mm) in x halfway up."""
    drift = SLOPE * z + np.array([stray * np.sin(np.pi * z / 400.0), 0.0])
    return pose(rotation_z(np.radians(theta_deg)), np.array([x + drift[0], y + drift[1], z]))


def probed(seed: int = 1, *, noise: float = 0.0, heights=HEIGHTS, turns=(-90.0, 90.0), stray: float = 0.0):
    mandrel, generator = draw_mandrel(seed, "CAL-MANDREL", np.zeros(2)), np.random.default_rng(seed)
    places = [(x, 0.0, 0.0, t) for t in turns for x in (-0.3, 0.3, 0.0)] + [
        (0.0, y, 0.0, t) for t in turns for y in (-0.3, 0.3)
    ]
    places += [(0.0, 0.0, float(z), t) for t in turns for z in heights[1:]]
    return [one(mandrel, AxesPosition(*place), noise * generator.normal(size=3), stray) for place in places]


def one(mandrel: Mandrel, at: AxesPosition, noise, stray: float) -> Probed:
    axis = mandrel.axis_at(table(at.x_mm, at.y_mm, at.z_mm, at.theta_deg, stray))
    return Probed(at, np.array([mandrel.probe_mm(i, axis) for i in range(3)]) + noise)


def found(readings, axis: TableAxis = UPRIGHT):
    return jack_line(readings, STAGE, axis, radius_mm=40.0)


def test_without_noise_the_line_is_exact_whatever_the_set_up() -> None:
    for seed in range(5):
        line = found(probed(seed))
        assert line.direction[:2] / line.direction[2] == pytest.approx(SLOPE, abs=1e-8)
        assert line.straightness_mm < 1e-6
        assert line.residual_mm < 1e-6


def test_a_bend_is_told_as_straightness_and_not_as_noise() -> None:
    line = found(probed(stray=0.02))
    assert line.straightness_mm == pytest.approx(0.008, abs=0.003)
    assert line.residual_mm < 1e-6
    assert line.path_mm[4, 0] == pytest.approx(SLOPE[0] * 200.0 + 0.02, abs=1e-4)


def test_errors_are_as_large_as_stated() -> None:
    errors, covariances = [], []
    for seed in range(60):
        line = found(probed(seed, noise=0.001))
        x, y = np.degrees(line.direction[:2] / line.direction[2] - SLOPE)
        errors.append(np.array([-y, x]))
        covariances.append(line.covariance)
    assert np.mean(nees(np.array(errors), np.array(covariances))) == pytest.approx(1.0, abs=0.35)


def test_a_leaning_table_axis_is_given_back() -> None:
    lean = replace(UPRIGHT, direction=np.array([1e-3, 0.0, 1.0]) / np.linalg.norm([1e-3, 0.0, 1.0]))
    line = found(probed(), lean)
    assert line.direction[:2] / line.direction[2] == pytest.approx(SLOPE + np.array([1e-3, 0.0]), abs=1e-8)


def test_the_middle_is_found_from_three_readings() -> None:
    mandrel = Mandrel(np.zeros(2), np.zeros(2), np.zeros(3), np.ones(3))
    aside = np.array([0.4, -0.3])
    gaps = np.array([mandrel.probe_mm(i, aside) for i in range(3)])
    assert centre_of(gaps) == pytest.approx(aside, abs=0.005)
    assert PROBES_MM < 400.0


def swapped():
    return [replace(one, gap_mm=one.gap_mm[[1, 0, 2]]) for one in probed()]


def knocked():
    readings = probed()
    return readings[:14] + [replace(one, gap_mm=one.gap_mm + np.array([0.1, 0.0, 0.0])) for one in readings[14:]]


@pytest.mark.parametrize(
    ("readings", "code"),
    [
        (probed(heights=HEIGHTS[:4]), "geometry_too_weak"),
        (probed(heights=tuple(np.linspace(0.0, 60.0, 9))), "geometry_too_weak"),
        (probed(turns=(0.0,)), "geometry_too_weak"),
        (swapped(), "probes_swapped"),
        ([replace(one, gap_mm=1e-3 * one.gap_mm) for one in probed()], "wrong_unit"),
        (knocked(), "residual_too_large"),
        (probed(stray=0.5), "residual_too_large"),
    ],
)
def test_refusals(readings, code: str) -> None:
    with pytest.raises(Refused) as refused:
        found(readings)
    assert refused.value.code == code
