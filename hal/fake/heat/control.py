"""The heater controller itself: own regulation with ramp, power limit, limit switch, watchdog, alarms that latch.

It belongs to the plant and lives on when a controller crashes; `hal.fake.devices.heating.FakeHeater` is the link to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from hal.fake.faults import FaultBook

NAME = "heater"


@dataclass(frozen=True, slots=True)
class RegulatorSettings:
    """Gains of the PI regulator and the limits that do not depend on a recipe."""

    gain_w_per_k: float = 80.0
    """About C / (3 (dead time + lag)) for C = 1.9 kJ/K (Skogestad's rule for integrating processes)."""
    integral_s: float = 150.0
    capacity_j_per_k: float = 1850.0
    """Feed-forward: what the ramp itself costs."""
    limit_switch_c: float = 130.0
    """Independent switch that opens the contactor."""
    watchdog_s: float = 5.0
    """Off-line trip after the link was lost for so long."""

    def tuned_to(self, capacity_j_per_k: float) -> RegulatorSettings:
        """The same regulator commissioned on a load of that heat capacity."""
        ratio = capacity_j_per_k / self.capacity_j_per_k
        return replace(self, gain_w_per_k=self.gain_w_per_k * ratio, capacity_j_per_k=capacity_j_per_k)


def regulate(
    settings: RegulatorSettings, error_k: float, integral_w: float, feed_w: float, limit_w: float, dt_s: float
) -> tuple[float, float]:
    """(power, new integral) of one tick; the integral stands while the output is at a limit."""
    wanted = settings.gain_w_per_k * error_k + integral_w + feed_w
    power = min(max(wanted, 0.0), limit_w)
    if power == wanted:
        integral_w += settings.gain_w_per_k / settings.integral_s * error_k * dt_s
    return power, integral_w


class HeaterControl:
    """Implements `hal.fake.heat.state.HeatSource`."""

    def __init__(self, settings: RegulatorSettings | None = None) -> None:
        self.settings = settings or RegulatorSettings()
        self.faults = FaultBook()
        self.stage_w = 0.0
        """What the power stage gives when it conducts fully."""
        self.on = False
        self.setpoint_c = math.nan
        self.ramp_k_per_s = 0.0
        self.limit_w = 0.0
        self.alarm = ""
        self.output_w = 0.0
        self.link_lost_s = math.inf
        self._ramped_c = math.nan
        self._integral_w = 0.0

    @property
    def idle(self) -> bool:
        """Whether the contactor is open."""
        return not self.on

    def start(self, setpoint_c: float, ramp_k_per_min: float, limit_w: float) -> None:
        """Regulate to `setpoint_c`; a running ramp goes on from where it is."""
        if not self.on:
            self._ramped_c, self._integral_w = math.nan, 0.0
        self.on = True
        self.setpoint_c, self.ramp_k_per_s, self.limit_w = setpoint_c, ramp_k_per_min / 60.0, limit_w

    def stop(self) -> None:
        """Open the contactor."""
        self.on = False
        self.output_w = 0.0

    def trip(self, alarm: str) -> None:
        """Open the contactor and latch the alarm."""
        self.stop()
        self.alarm = self.alarm or alarm

    def power_w(self, now: float, sensed_c: float, dt_s: float) -> float:
        """Watts that reach the heating element from `now` on."""
        if self.on and (alarm := self._tripping(now, sensed_c)):
            self.trip(alarm)
        if not self.on:
            return 0.0
        self.output_w = self._regulated(sensed_c, dt_s)
        if self.faults.active(NAME, "loop_break", now):
            return 0.0
        if self.faults.active(NAME, "stuck_on", now):
            return self.stage_w
        return self.output_w

    def _tripping(self, now: float, sensed_c: float) -> str:
        if cut := self.faults.power_cut(now):
            return f"safety circuit open ({cut})"
        if sensed_c > self.settings.limit_switch_c or self.faults.active(NAME, "over_temperature", now):
            return "over-temperature"
        if self.faults.active(NAME, "watchdog_trip", now) or now - self._silent_since(now) > self.settings.watchdog_s:
            return "watchdog"
        return ""

    def _silent_since(self, now: float) -> float:
        """Since when the controller has heard nothing; `now` while the link stands."""
        silent = min(self.link_lost_s, now)
        for kind in ("gone", "hung"):
            if fault := self.faults.active(NAME, kind, now):
                silent = min(silent, self.faults.start_s(fault))
        return silent

    def _regulated(self, sensed_c: float, dt_s: float) -> float:
        before = sensed_c if math.isnan(self._ramped_c) else self._ramped_c
        reach = self.ramp_k_per_s * dt_s
        self._ramped_c = before + min(max(self.setpoint_c - before, -reach), reach)
        feed_w = self.settings.capacity_j_per_k * (self._ramped_c - before) / dt_s
        power, self._integral_w = regulate(
            self.settings, self._ramped_c - sensed_c, self._integral_w, feed_w, self.limit_w, dt_s
        )
        return power
