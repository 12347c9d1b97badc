"""The plant's heat advanced lazily: who looks when makes no difference, sensors lag, new parts are cold."""

from dataclasses import replace

import numpy as np
import pytest

from hal.fake.geometry import JointGeometry
from hal.fake.heat.control import HeaterControl
from hal.fake.heat.state import Thermal, ThermalImperfections, drawn_imperfections, drawn_properties
from hal.fake.heat.thermal import ThermalProperties, Zones
from hal.fake.levels import numbers
from hal.fake.parts import ShaftTruth, draw_shaft

GEOMETRY = JointGeometry(angles_deg=tuple(10.0 * i for i in range(36)))


class Parts:
    """The shaft that is in."""

    def __init__(self) -> None:
        self.shaft: ShaftTruth = self.draw("S-1")

    def draw(self, serial: str) -> ShaftTruth:
        return draw_shaft(GEOMETRY, numbers("nominal"), 1, serial)

    def __call__(self) -> ShaftTruth:
        return self.shaft


def heated(setpoint_c: float = 65.0, **sensors: float) -> tuple[Thermal, HeaterControl]:
    control = HeaterControl()
    control.stage_w = 4000.0
    thermal = Thermal(ThermalProperties(), ThermalImperfections(**sensors), Parts())  # type: ignore[arg-type]
    thermal.source = control
    control.start(setpoint_c, 10.0, 3000.0)
    return thermal, control


def test_it_reaches_the_setpoint_with_the_ramp_and_little_overshoot() -> None:
    thermal, _ = heated()
    thermal.advance(120.0, 300.0)
    assert 30.0 < thermal.shaft_c < 42.0
    thermal.advance(260.0, 300.0)
    highest = thermal.shaft_c
    for now in range(260, 900, 5):
        thermal.advance(float(now), 300.0)
        highest = max(highest, thermal.shaft_c)
    # On the ramp the rim runs ahead of its root, where the regulator's sensor is.
    assert thermal.shaft_c == pytest.approx(65.0, abs=0.5) and highest < 68.5
    assert thermal.rotor_c == pytest.approx(20.0, abs=0.2)


def test_it_does_not_matter_how_often_somebody_looks() -> None:
    rare, often = heated()[0], heated()[0]
    rare.advance(400.0, 300.0)
    for now in np.arange(0.137, 400.0, 0.731):
        often.advance(float(now), 300.0)
    often.advance(400.0, 300.0)
    assert rare.zones == often.zones and rare.thermocouple_c(0) == often.thermocouple_c(0)


def test_time_does_not_go_back() -> None:
    thermal, _ = heated()
    thermal.advance(100.0, 300.0)
    before = thermal.zones
    thermal.advance(50.0, 300.0)
    assert thermal.zones == before


def test_power_comes_after_the_dead_time() -> None:
    thermal, _ = heated(dead_time_s=5.0)
    thermal.advance(5.0, 300.0)
    assert thermal.zones == Zones(20.0, 20.0, 20.0, 20.0)
    thermal.advance(12.0, 300.0)
    assert thermal.shaft_c > 20.3


def test_thermocouples_lag_and_are_biased() -> None:
    thermal, _ = heated(thermocouple_lag_s=10.0, thermocouple_bias_k=(1.0, 0.0, 0.0))  # type: ignore[arg-type]
    thermal.advance(200.0, 300.0)
    rise = thermal.shaft_c - thermal.thermocouple_c(0)
    # A ramp of 10 K/min is 1.7 K over a lag of 10 s; the bias hides 1 K of it.
    assert rise == pytest.approx(10.0 / 6.0 - 1.0, abs=0.2)


def test_seating_grips_the_spigot_and_warms_the_rotor() -> None:
    thermal, control = heated()
    thermal.advance(600.0, 300.0)
    assert thermal.interference_mm < -0.02
    thermal.settle(600.3, 300.0)
    control.stop()
    thermal.advance(603.0, 1.5)
    assert thermal.interference_mm < 0.0
    thermal.advance(618.0, 0.0)
    assert thermal.interference_mm > 0.0 and thermal.rotor_c > 25.0
    thermal.advance(1200.0, 0.0)
    assert abs(thermal.clamp_difference_k) < 1.0 and thermal.shaft_c > 30.0


def test_other_parts_are_cold_and_bring_their_own_fit() -> None:
    thermal, control = heated()
    parts = thermal._part
    assert isinstance(parts, Parts)
    thermal.advance(600.0, 300.0)
    control.stop()
    parts.shaft = parts.draw("S-2")
    thermal.advance(601.0, 300.0)
    assert thermal.shaft_c == pytest.approx(20.0, abs=1e-6)
    assert thermal.interference_mm == pytest.approx(parts.shaft.interference_mm, abs=1e-9)


def test_heating_the_rotor_opens_a_rotor_that_has_the_bore() -> None:
    properties = replace(ThermalProperties(), heated="rotor")
    thermal = Thermal(properties, ThermalImperfections(), Parts())
    control = HeaterControl()
    thermal.source = control
    control.start(65.0, 10.0, 3000.0)
    thermal.advance(600.0, 300.0)
    assert thermal.rotor_c > 60.0 and thermal.interference_mm < 0.0 and thermal.thermocouple_c(2) < 21.0


def test_drawn_numbers_come_from_drawing_and_level() -> None:
    drawing = replace(GEOMETRY, spigot_diameter_mm=120.0, heated_member="rotor")
    properties = drawn_properties(drawing, numbers("nominal"))
    assert properties.spigot_diameter_mm == 120.0 and properties.heated == "rotor"
    ideal = drawn_imperfections(numbers("ideal"), np.random.default_rng(1))
    assert ideal.thermocouple_bias_k == (0.0, 0.0, 0.0) and ideal.emissivity == ideal.set_emissivity
    draws = [drawn_imperfections(numbers("nominal"), np.random.default_rng(i)).regulator_bias_k for i in range(400)]
    assert np.std(draws) == pytest.approx(1.0, rel=0.15)
