"""Levels of imperfection, and overrides by name."""

from __future__ import annotations

import dataclasses
import math

import pytest

from hal.errors import ConfigError
from hal.fake.levels import Imperfections, Properties, imperfections, numbers, unit_of


def test_nominal_is_the_table() -> None:
    nominal = imperfections("nominal")
    assert nominal == Imperfections()
    assert nominal.view_rotation_deg == 0.002
    assert nominal.feature_position_mm == 0.01
    assert nominal.chuck_eccentricity_mm == 2.0


def test_ideal_has_no_error_but_the_noise_floors() -> None:
    ideal = imperfections("ideal")
    assert ideal.scanner_noise_mm == 0.005
    left = {f.name for f in dataclasses.fields(ideal) if getattr(ideal, f.name) != 0.0}
    assert left == {"scanner_noise_mm", "scanner_correlation_px", "force_noise_n"}


def test_hostile_is_three_times_nominal_with_six_percent_outliers() -> None:
    hostile, nominal = imperfections("hostile"), imperfections("nominal")
    special = {"scanner_outliers": 0.06, "scanner_correlation_px": 3.0, "chuck_clocking_deg": 180.0}
    for field in dataclasses.fields(hostile):
        expected = special.get(field.name, 3.0 * getattr(nominal, field.name))
        assert getattr(hostile, field.name) == pytest.approx(expected), field.name


def test_overrides_replace_by_name_in_either_table() -> None:
    twin = numbers("ideal", {"feature_tilt_deg": 0.5, "camera_rotor_shift_x_mm": 0.4})
    assert twin.imperfections.feature_tilt_deg == 0.5
    assert twin.properties.camera_rotor_shift_x_mm == 0.4
    assert twin.overrides == {"feature_tilt_deg": 0.5, "camera_rotor_shift_x_mm": 0.4}


def test_a_name_of_both_tables_is_the_property_and_sigma_its_scatter() -> None:
    twin = numbers("nominal", {"force_gain": 1.1, "sigma_force_gain": 0.0})
    assert twin.properties.force_gain == 1.1
    assert twin.imperfections.force_gain == 0.0


@pytest.mark.parametrize("name", ["no_such_number", "", "sigma_nothing", "Force_Gain"])
def test_an_unknown_name_is_refused_with_its_place(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        numbers("nominal", {name: 1.0})
    assert caught.value.place == f"twin.overrides.{name}"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_value_must_be_finite(value: float) -> None:
    with pytest.raises(ConfigError, match="finite"):
        numbers("nominal", {"force_gain": value})


def test_every_number_has_a_unit() -> None:
    for table in (Imperfections, Properties):
        for field in dataclasses.fields(table):
            assert unit_of(field.name), field.name
    with pytest.raises(KeyError):
        unit_of("nothing")
