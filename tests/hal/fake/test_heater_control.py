"""The regulator and the trips of the heater controller, without a joint."""

import pytest

from hal.fake.heat.control import HeaterControl, RegulatorSettings, regulate

SETTINGS = RegulatorSettings()


def test_output_stays_within_its_limits_and_the_integral_stands_there() -> None:
    power, integral = regulate(SETTINGS, 100.0, 50.0, 0.0, 3000.0, 0.5)
    assert power == 3000.0 and integral == 50.0
    power, integral = regulate(SETTINGS, -100.0, 50.0, 0.0, 3000.0, 0.5)
    assert power == 0.0 and integral == 50.0


def test_inside_the_limits_it_is_a_pi_regulator_with_feed_forward() -> None:
    power, integral = regulate(SETTINGS, 1.0, 50.0, 300.0, 3000.0, 0.5)
    assert power == pytest.approx(80.0 + 50.0 + 300.0)
    assert integral == pytest.approx(50.0 + 80.0 / 150.0 * 0.5)


def test_a_ramp_costs_what_the_metal_takes_up() -> None:
    control = HeaterControl()
    control.start(65.0, 10.0, 3000.0)
    # On the ramp with the sensor just behind: capacity times ramp, 1850 J/K * 1/6 K/s, and a little for the error.
    assert control.power_w(0.0, 20.0, 0.5) == pytest.approx(1850.0 / 6.0, abs=10.0)


def test_the_power_limit_of_the_order_holds() -> None:
    control = HeaterControl()
    control.start(65.0, 600.0, 400.0)
    assert control.power_w(0.0, 20.0, 0.5) == 400.0


def test_the_limit_switch_opens_the_contactor_and_latches() -> None:
    control = HeaterControl()
    control.start(65.0, 10.0, 3000.0)
    assert control.power_w(0.0, 131.0, 0.5) == 0.0
    assert control.alarm == "over-temperature" and control.idle
    assert control.power_w(1.0, 20.0, 0.5) == 0.0


def test_the_watchdog_waits_its_time_after_the_link_was_lost() -> None:
    control = HeaterControl()
    control.start(65.0, 10.0, 3000.0)
    control.link_lost_s = 10.0
    assert control.power_w(14.0, 20.0, 0.5) > 0.0 and not control.alarm
    assert control.power_w(15.5, 20.0, 0.5) == 0.0 and control.alarm == "watchdog"


def test_the_first_alarm_is_kept() -> None:
    control = HeaterControl()
    control.trip("watchdog")
    control.trip("over-temperature")
    assert control.alarm == "watchdog"
