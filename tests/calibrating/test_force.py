"""Gain and offset from weights: exact without noise, friction cancelled, units told apart, weak sets refused."""

from __future__ import annotations

import numpy as np
import pytest

from cellctl.calibrating.force import Weighed, force_gain
from cellctl.calibrating.hang import spread_masses
from cellctl.calibration import ForceGain
from cellctl.vision.part import Refused
from hal.units import GRAVITY_M_S2

MASSES = (0.0, 40.0, 80.0, 120.0, 160.0)


def read(masses=MASSES, *, per_newton: float = 1.0, offset: float = 0.0, friction: float = 2.0, wrong: float = 0.0):
    """What a linear sensor says, the heaviest weight `wrong` newton off."""
    values = [per_newton * mass * GRAVITY_M_S2 + offset for mass in masses]
    values[-1] += wrong
    return [Weighed(m, value + friction, value - friction, 0.1) for m, value in zip(masses, values, strict=True)]


def found(weighed, range_n: float = 2000.0):
    return force_gain(weighed, range_n=range_n, mass_sigma=3e-5)


def test_a_line_is_found_and_friction_cancels() -> None:
    force = found(read(per_newton=1.1, offset=7.0))
    assert force.gain == pytest.approx(1.0 / 1.1)
    assert force.offset_n == pytest.approx(7.0)
    assert force.friction_n == pytest.approx(2.0)
    belief = ForceGain(gain=force.gain, offset_n=force.offset_n)
    assert belief.true_n(1.1 * 981.0 + 7.0) == pytest.approx(981.0)


def test_stated_sigmas_hold_the_errors() -> None:
    inside = 0
    for seed in range(60):
        generator = np.random.default_rng(seed)
        weighed = [
            Weighed(one.mass_kg, one.up_n + e, one.down_n + e, 0.1)
            for one, e in zip(read(per_newton=0.9), generator.normal(0.0, 0.2, len(MASSES)), strict=True)
        ]
        force = found(weighed)
        inside += abs(force.gain - 1.0 / 0.9) < 2.0 * np.sqrt(force.covariance[0, 0])
    assert inside >= 54


@pytest.mark.parametrize(
    ("weighed", "code", "said"),
    [
        (read(masses=(0.0, 100.0)), "geometry_too_weak", "2 weights"),
        (read(masses=(80.0, 85.0, 90.0)), "geometry_too_weak", "98 N"),
        (read(per_newton=1.0 / GRAVITY_M_S2), "wrong_unit", "kilograms"),
        (read(per_newton=1e-3, friction=0.0), "wrong_unit", "kilonewton"),
        (read(per_newton=-1.0), "wrong_unit", "sign"),
        (read(wrong=60.0), "residual_too_large", "wrong weight"),
        (read(per_newton=1.3), "out_of_range", "160 kg"),
        (read(offset=float("nan")), "not_measurable", "no number"),
    ],
)
def test_refusals(weighed, code: str, said: str) -> None:
    with pytest.raises(Refused, match=said) as refused:
        found(weighed)
    assert refused.value.code == code


@pytest.mark.parametrize("range_n", [50.0, 2000.0, 10_000.0])
def test_weights_spread_over_the_range_and_stay_inside(range_n: float) -> None:
    masses = spread_masses(range_n)
    assert len(set(masses)) == 5
    assert masses[0] == 0.0
    assert 0.6 * range_n < masses[-1] * GRAVITY_M_S2 < 0.85 * range_n
