"""The plant's heat: zones, lagging sensors and whatever heats, advanced lazily on a grid of its own.

The grid depends on the physical state alone, never on who looks when: the same history gives the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from hal.fake.geometry import JointGeometry
from hal.fake.heat.thermal import (
    ThermalProperties,
    Zones,
    at_rest,
    circle_growth,
    interference_mm,
    lagged,
    midpoint,
    ring_j_per_k,
    step,
)
from hal.fake.levels import TwinNumbers

TICK_S = 0.5
QUIET_TICK_S = 5.0
"""Grid while nothing heats and the rims agree."""
QUIET_K = 1.0


class Fit(Protocol):
    """The part that has the bore."""

    @property
    def interference_mm(self) -> float:
        """Diametral, both members at 20 C."""
        ...


class HeatSource(Protocol):
    """Whatever puts power into the heated member. Asked once per tick."""

    def power_w(self, now: float, sensed_c: float, dt_s: float) -> float:
        """Power from `now` on for `dt_s`, given what the regulator's own sensor shows."""
        ...

    @property
    def idle(self) -> bool:
        """Whether it is switched off and stays so until commanded."""
        ...


@dataclass(frozen=True, slots=True)
class ThermalImperfections:
    """Sensors as they are. Biases of (spigot_tc_1, spigot_tc_2, rotor_tc), kelvin."""

    thermocouple_lag_s: float = 2.0
    thermocouple_noise_k: float = 0.05
    thermocouple_bias_k: tuple[float, float, float] = (0.0, 0.0, 0.0)
    regulator_bias_k: float = 0.0
    """Error of the heater controller's own sensor."""
    pyrometer_noise_k: float = 0.2
    emissivity: float = 0.95
    """True emissivity of the spigot; the pyrometer is set to `set_emissivity`."""
    set_emissivity: float = 0.95
    dead_time_s: float = 5.0
    """From the power stage to the metal."""


def drawn_properties(geometry: JointGeometry, numbers: TwinNumbers) -> ThermalProperties:
    """Thermal data of a joint from its drawing: a flange as thick as its holes are deep, a disc twice as heavy."""
    drawn, usual = geometry, ThermalProperties()
    flange_j_per_k = ring_j_per_k(drawn.face_inner_diameter_mm, drawn.face_outer_diameter_mm, drawn.hole_depth_mm)
    around = drawn.spigot_diameter_mm / usual.spigot_diameter_mm
    rim = around * drawn.spigot_length_mm / usual.spigot_length_mm
    return ThermalProperties(
        rim_j_per_k=usual.rim_j_per_k * rim,
        flange_j_per_k=flange_j_per_k,
        disc_j_per_k=2.0 * flange_j_per_k,
        neck_w_per_k=usual.neck_w_per_k * around,
        loss_time_s=usual.loss_time_s * flange_j_per_k / usual.flange_j_per_k,
        ambient_c=numbers.properties.ambient_c,
        spigot_diameter_mm=geometry.spigot_diameter_mm,
        spigot_length_mm=geometry.spigot_length_mm,
        face_inner_diameter_mm=geometry.face_inner_diameter_mm,
        face_outer_diameter_mm=geometry.face_outer_diameter_mm,
        expansion_per_k=geometry.expansion_per_k,
        interference_mm=geometry.interference_mm,
        heated=geometry.heated_member,
    )


def drawn_imperfections(numbers: TwinNumbers, rng: np.random.Generator) -> ThermalImperfections:
    """One heater with its sensors. The level's tolerance of the docking difference is three sigma of the regulator's
    own sensor; contact thermocouples are five times as good, the pyrometer's emissivity is 1 % off per kelvin of it."""
    tolerance_k = numbers.imperfections.docking_difference_k
    bias = rng.normal(0.0, tolerance_k / 15.0, 3)
    return ThermalImperfections(
        thermocouple_bias_k=(float(bias[0]), float(bias[1]), float(bias[2])),
        regulator_bias_k=float(rng.normal(0.0, tolerance_k / 3.0)),
        emissivity=0.95 - 0.01 * tolerance_k,
    )


class Thermal:
    """State of the heat. `part` gives the shaft that is in; another one comes at the temperature of the room."""

    def __init__(
        self,
        properties: ThermalProperties,
        imperfections: ThermalImperfections,
        part: Callable[[], Fit],
        now: float = 0.0,
    ) -> None:
        self.properties = properties
        self.imperfections = imperfections
        self.source: HeatSource | None = None
        self._part = part
        self.reset(now)

    def reset(self, now: float) -> None:
        """Other parts, at the temperature of the room."""
        self._in = self._part()
        self.properties = replace(self.properties, interference_mm=self._in.interference_mm)
        self._grid_s = self.now = now
        self._grid = at_rest(self.properties)
        self._between: Zones | None = None
        self._delayed: deque[float] = deque([0.0] * round(self.imperfections.dead_time_s / TICK_S))
        self._gap_mm = 1e3
        self._sensed = [self._at_site(site, self._grid) for site in range(4)]

    # ------------------------------------------------------------ what the plant asks

    def advance(self, now: float, gap_mm: float) -> None:
        """Integrate to `now` with the faces `gap_mm` apart since the last call."""
        if now <= self.now:
            return
        if self._part() is not self._in:
            self.reset(self.now)
        self._gap_mm = gap_mm
        while (tick := self._tick()) <= now - self._grid_s:
            self._commit(tick)
        self.now = now
        self._between = None

    def settle(self, now: float, gap_mm: float) -> None:
        """Advance and start the grid anew at `now`: called before a command changes what heats."""
        self.advance(now, gap_mm)
        if now > self._grid_s:
            self._commit(now - self._grid_s)

    @property
    def zones(self) -> Zones:
        """Temperatures at the last advance: a small step beyond the grid, which the grid does not keep."""
        if self._between is None:
            power_w = self._delayed[0] if self._delayed else 0.0
            rest_s = self.now - self._grid_s
            self._between = midpoint(self.properties, self._grid, power_w, self._gap_mm, rest_s)
        return self._between

    @property
    def shaft_c(self) -> float:
        """The shaft's side of the spigot."""
        return self.zones.shaft_rim_c

    @property
    def rotor_c(self) -> float:
        """The rotor's side of the spigot."""
        return self.zones.rotor_rim_c

    @property
    def interference_mm(self) -> float:
        """Present diametral interference; negative is clearance."""
        return interference_mm(self.properties, self.zones)

    @property
    def circle_growth(self) -> float:
        """Relative growth of the hole circle against the stud circle."""
        return circle_growth(self.properties, self.zones)

    @property
    def clamp_difference_k(self) -> float:
        """Shaft's flange against the studs, which have the rotor's temperature: it loads or unloads the bolts."""
        return self.zones.shaft_flange_c - self.zones.rotor_disc_c

    def thermocouple_c(self, site: int) -> float:
        """What the junction of site 0 (spigot_tc_1), 1 (spigot_tc_2), 2 (rotor_tc) has, lag and bias included."""
        lag_s = self.imperfections.thermocouple_lag_s
        now = lagged(self._sensed[site], self._at_site(site, self.zones), lag_s, self.now - self._grid_s)
        return now + self.imperfections.thermocouple_bias_k[site]

    @property
    def spigot_c(self) -> float:
        """Surface of the heated spigot, which the pyrometer sees."""
        return self._at_site(0, self.zones)

    # ------------------------------------------------------------ grid

    def _tick(self) -> float:
        quiet = (self.source is None or self.source.idle) and not any(self._delayed)
        agree = abs(self._grid.shaft_rim_c - self._grid.rotor_rim_c) < QUIET_K
        return QUIET_TICK_S if quiet and agree else TICK_S

    def _commit(self, dt_s: float) -> None:
        sensed = self._sensed[3] + self.imperfections.regulator_bias_k
        asked = self.source.power_w(self._grid_s, sensed, dt_s) if self.source else 0.0
        self._delayed.append(asked)
        power_w = self._delayed.popleft()
        lag_s = self.imperfections.thermocouple_lag_s
        self._grid = step(self.properties, self._grid, power_w, self._gap_mm, dt_s)
        self._sensed = [
            lagged(value, self._at_site(site, self._grid), lag_s, dt_s) for site, value in enumerate(self._sensed)
        ]
        self._grid_s += dt_s
        self._between = None

    def _at_site(self, site: int, zones: Zones) -> float:
        """0: heated rim, 1: heated rim's root, 2: body of the other member, 3: the regulator's, as 1."""
        shaft = self.properties.heated == "shaft"
        rim, body = (zones.shaft_rim_c, zones.shaft_flange_c) if shaft else (zones.rotor_rim_c, zones.rotor_disc_c)
        other = zones.rotor_disc_c if shaft else zones.shaft_flange_c
        return (rim, 0.5 * (rim + body), other, 0.5 * (rim + body))[site]
