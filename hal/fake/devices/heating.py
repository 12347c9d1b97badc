"""Fake heater and thermometers: links to the plant's heater controller and sensors."""

from __future__ import annotations

import asyncio
import math

import numpy as np

from hal.errors import ConfigError, DeviceRefused, SafetyOpen
from hal.fake.devices.io import IoDevice
from hal.fake.faults import FaultBook
from hal.fake.heat.control import HeaterControl, RegulatorSettings
from hal.fake.heat.state import Thermal, drawn_imperfections, drawn_properties
from hal.fake.heat.thermal import pyrometer_c
from hal.fake.plant import Plant
from hal.interfaces import HeaterState, Identity, Reading, SafeState

SITES = {"spigot_tc_1": 0, "spigot_tc_2": 1, "rotor_tc": 2}


class FakeThermometer(IoDevice):
    """`spigot_tc_1`, `spigot_tc_2`, `rotor_tc` (contact thermocouples) or `pyrometer`. Implements `Thermometer`."""

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        """Raises ConfigError for a name that has no place on the joint."""
        super().__init__(name, plant, faults)
        self.model = "pyrometer" if name == "pyrometer" else "thermocouple"
        if name != "pyrometer" and name not in SITES:
            raise ConfigError("has no place on the joint", place=f"devices.{name}")
        self._rng: np.random.Generator = plant.rng(name, "noise")

    async def read(self) -> Reading:
        """Temperature in degrees Celsius."""
        now = await self._exchange("read")
        return self._faults.reading(self.name, self._seen_c(now), now)

    def _seen_c(self, now: float) -> float:
        thermal = thermal_of(self._plant)
        sensors = thermal.imperfections
        if self.name != "pyrometer":
            return thermal.thermocouple_c(SITES[self.name]) + sensors.thermocouple_noise_k * self._noise()
        wrong = self._faults.active(self.name, "wrong_emissivity", now)
        emissivity = sensors.emissivity * (wrong.number if wrong else 1.0)
        ambient_c = thermal.properties.ambient_c
        shown = pyrometer_c(thermal.spigot_c, ambient_c, emissivity, sensors.set_emissivity)
        return shown + sensors.pyrometer_noise_k * self._noise()

    def _noise(self) -> float:
        return float(self._rng.standard_normal())


class FakeHeater(IoDevice):
    """Link to the plant's heater controller. Implements `Heater`."""

    model = "heater controller"

    def __init__(self, name: str, plant: Plant, faults: FaultBook, max_power_w: float) -> None:
        super().__init__(name, plant, faults)
        self._max_power_w = max_power_w

    @property
    def max_power_w(self) -> float:
        """What the power stage can give."""
        return self._max_power_w

    async def connect(self) -> Identity:
        """Prove the controller's identity; it watches this link from now on."""
        identity = await super().connect()
        control = self._control()
        control.faults = self._faults
        control.stage_w = self._max_power_w
        control.link_lost_s = math.inf
        return identity

    async def close(self) -> None:
        """Drop the link; a controller left regulating trips off-line by its watchdog."""
        if self._connected:
            self._connected = False
            self._control().link_lost_s = asyncio.get_running_loop().time()

    async def halt(self) -> None:
        """Open the contactor, read back."""
        state = await self.off()
        if state.on:
            raise DeviceRefused("the contactor does not open", device=self.name)

    async def safe(self) -> SafeState:
        """Safe with the contactor open and no power asked."""
        state = await self.read()
        return SafeState(not state.on and state.power_w == 0.0, "contactor open" if not state.on else "heating")

    async def rearm(self) -> None:
        """Clear a latched alarm whose cause is gone; the set-point becomes what is measured; power stays off.

        Raises SafetyOpen while the safety circuit is open.
        """
        now = await self._exchange("rearm")
        control = self._control()
        if cut := self._faults.power_cut(now):
            raise SafetyOpen(f"no power ({cut})", device=self.name)
        control.alarm = ""
        if not control.on:
            control.setpoint_c = thermal_of(self._plant).thermocouple_c(0)

    async def read(self) -> HeaterState:
        """What the controller says of itself."""
        now = await self._exchange("read")
        return self._state(now)

    async def heat(self, setpoint_c: float, *, ramp_k_per_min: float, max_power_w: float) -> HeaterState:
        """Regulate. Raises DeviceRefused (alarm latched, value out of range), SafetyOpen (no power)."""
        now = await self._exchange("heat")
        control = self._control()
        if cut := self._faults.power_cut(now):
            raise SafetyOpen(f"no power ({cut})", device=self.name)
        if control.alarm:
            raise DeviceRefused(f"alarm: {control.alarm}", device=self.name)
        limit_c = control.settings.limit_switch_c
        if not setpoint_c < limit_c:
            raise DeviceRefused(f"set-point {setpoint_c} C (limit {limit_c} C)", device=self.name)
        if not 0.0 < max_power_w <= self._max_power_w:
            raise DeviceRefused(f"power {max_power_w} W (limit {self._max_power_w} W)", device=self.name)
        if not ramp_k_per_min > 0.0:
            raise DeviceRefused(f"ramp {ramp_k_per_min} K/min", device=self.name)
        if not self._faults.active(self.name, "setpoint_not_taken", now):
            self._settle(now)
            control.start(setpoint_c, ramp_k_per_min, max_power_w)
        return self._state(now)

    async def off(self) -> HeaterState:
        """Open the contactor."""
        now = await self._exchange("off")
        self._settle(now)
        self._control().stop()
        return self._state(now)

    def _settle(self, now: float) -> None:
        thermal_of(self._plant).settle(now, self._plant.gap_mm())

    def _control(self) -> HeaterControl:
        source = thermal_of(self._plant).source
        if not isinstance(source, HeaterControl):
            raise ConfigError("the plant has no heater controller", place=f"devices.{self.name}")
        return source

    def _state(self, now: float) -> HeaterState:
        control = self._control()
        if control.on and (cut := self._faults.power_cut(now)):
            control.trip(f"safety circuit open ({cut})")
        return HeaterState(
            setpoint_c=control.setpoint_c,
            power_w=control.output_w,
            on=control.on,
            watchdog_armed=self._connected,
            alarm=control.alarm,
            time_s=now,
        )


def thermal_of(plant: Plant) -> Thermal:
    """The plant's heat. Raises ConfigError on a bench without one."""
    if not isinstance(plant.thermal, Thermal):
        raise ConfigError("the plant has no heat", place="plant.thermal")
    return plant.thermal


def install_heat(plant: Plant) -> Thermal:
    """Give the plant its heat and a heater controller; returns the heat."""
    thermal = Thermal(
        drawn_properties(plant.geometry, plant.numbers),
        drawn_imperfections(plant.numbers, plant.rng("thermal")),
        lambda: plant.shaft,
        plant.now,
    )
    thermal.source = HeaterControl(RegulatorSettings().tuned_to(thermal.properties.heated_j_per_k))
    plant.thermal = thermal
    return thermal
