"""Thermometers and the heater controller over Modbus."""

from __future__ import annotations

import asyncio
import math

from hal.bus.modbus import Lines
from hal.codec import maps
from hal.codec.registers import Image
from hal.entries import ModbusEntry, ModbusHeaterEntry, ModbusPyrometerEntry
from hal.errors import DeviceRefused, SafetyOpen
from hal.interfaces import HeaterState, SafeState
from hal.real.measuring import Measuring
from hal.real.modbus import ModbusDevice, Values

POLLS_PER_WATCHDOG = 5.0
EMISSIVITY_TOLERANCE = 0.001


class Thermocouple(Measuring):
    """One channel of a thermocouple module. Implements `hal.interfaces.Thermometer`."""

    def __init__(self, name: str, entry: ModbusEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines, maps.THERMOCOUPLE, maps.TC_VALUE, maps.TC_STATUS, maps.TC_COUNTER)


class Pyrometer(Measuring):
    """A pyrometer. Implements `hal.interfaces.Thermometer`."""

    def __init__(self, name: str, entry: ModbusPyrometerEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines, maps.PYROMETER, maps.PYRO_VALUE, maps.PYRO_STATUS, maps.PYRO_COUNTER)
        self._emissivity = entry.emissivity

    async def _settle(self) -> None:
        """Another emissivity than the cell's reads another temperature."""
        there = self._value(await self._read(maps.PYROMETER), maps.PYRO_EMISSIVITY)
        if abs(there - self._emissivity) > EMISSIVITY_TOLERANCE:
            raise DeviceRefused(f"emissivity set to {there:.3f}, expected {self._emissivity:.3f}", device=self.name)


class Heater(ModbusDevice):
    """A heater controller with an off-line watchdog. Implements `hal.interfaces.Heater`.

    Power is asked for only while the watchdog was read back armed. The controller keeps its orders in EEPROM, so they
    are written when they change and never in a cycle; what the line's monitor polls is read.
    """

    def __init__(self, name: str, entry: ModbusHeaterEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines)
        self._max_power_w = entry.max_power_w
        self._watchdog_s = entry.watchdog_s
        self._resets = 0

    @property
    def max_power_w(self) -> float:
        """What the power stage can give."""
        return self._max_power_w

    async def _settle(self) -> None:
        """Arm the watchdog, and keep it fed by reading."""
        await self._arm()
        self._line.poll(self, self._entry.unit, self._watchdog_s / POLLS_PER_WATCHDOG, self.read)

    async def read(self) -> HeaterState:
        """What the controller says of itself."""
        return self._state(await self._read(maps.HEATER_STATE))

    async def heat(self, setpoint_c: float, *, ramp_k_per_min: float, max_power_w: float) -> HeaterState:
        """Regulate. Raises DeviceRefused (alarm latched, value out of range), SafetyOpen (no power), DeviceFault."""
        if not math.isfinite(setpoint_c):
            raise DeviceRefused(f"set-point {setpoint_c} C", device=self.name)
        if not 0.0 < max_power_w <= self._max_power_w:
            raise DeviceRefused(f"power {max_power_w} W (limit {self._max_power_w} W)", device=self.name)
        if not 0.0 < ramp_k_per_min < math.inf:
            raise DeviceRefused(f"ramp {ramp_k_per_min} K/min", device=self.name)
        image = await self._powered()
        if alarm := self._state(image).alarm:
            raise DeviceRefused(f"alarm: {alarm}", device=self.name)
        await self._arm()
        await self._order(setpoint_c, ramp_k_per_min, max_power_w)
        await self._send(maps.HEATER_RUN, {maps.HEATER_RUN_WORD: 1})
        state = await self.read()
        if not (state.on and state.watchdog_armed):
            raise self._fault(f"asked to heat it says on {state.on}, watchdog armed {state.watchdog_armed}")
        return state

    async def off(self) -> HeaterState:
        """Open the contactor. Raises DeviceFault where it stays closed."""
        await self._send(maps.HEATER_RUN, {maps.HEATER_RUN_WORD: 0})
        state = await self.read()
        if state.on:
            raise self._fault("the contactor does not open")
        return state

    async def halt(self) -> None:
        """Open the contactor, read back."""
        await self.off()

    async def safe(self) -> SafeState:
        """Safe with the contactor open and no power asked."""
        state = await self.read()
        return SafeState(not state.on and state.power_w == 0.0, "contactor open" if not state.on else "heating")

    async def rearm(self) -> None:
        """Have the controller clear a latched alarm whose cause is gone and take what it measures as its set-point.

        Raises SafetyOpen while the safety circuit is open, DeviceFault where the alarm stays.
        """
        await self._powered()
        self._resets = self._resets % 0xFFFF + 1
        await self._write(maps.HEATER_RESET, {maps.HEATER_RESET_WORD: self._resets})
        state = await self.read()
        if state.alarm:
            raise self._fault(f"alarm stays: {state.alarm}")

    async def _powered(self) -> Image:
        image = await self._read(maps.HEATER_STATE)
        if "supply" not in self._value(image, maps.HEATER_STATUS):
            raise SafetyOpen("no power: the safety circuit is open", device=self.name)
        return image

    async def _arm(self) -> None:
        """Set the watchdog where it is not set so, and have it read back armed."""
        there = self._value(await self._read(maps.HEATER_WATCHDOG), maps.HEATER_WATCHDOG_S)
        if there != self._watchdog_s:
            await self._write(maps.HEATER_WATCHDOG, {maps.HEATER_WATCHDOG_S: self._watchdog_s})
        if not (await self.read()).watchdog_armed:
            raise self._fault(f"the watchdog is not armed by {self._watchdog_s:g} s: no power without it")

    async def _order(self, setpoint_c: float, ramp_k_per_min: float, max_power_w: float) -> None:
        """Write the orders where they differ from what is there."""
        wanted: Values = {
            maps.ORDER_SETPOINT: setpoint_c,
            maps.ORDER_RAMP: ramp_k_per_min,
            maps.ORDER_LIMIT: max_power_w,
        }
        if (await self._read(maps.HEATER_ORDER)).words != self._words(maps.HEATER_ORDER, wanted):
            await self._write(maps.HEATER_ORDER, wanted)

    def _state(self, image: Image) -> HeaterState:
        status, number = self._value(image, maps.HEATER_STATUS), self._integer(image, maps.HEATER_ALARM)
        known = number < len(maps.HEATER_ALARMS)
        setpoint_c, power_w = self._value(image, maps.HEATER_SETPOINT), self._value(image, maps.HEATER_POWER)
        return HeaterState(
            setpoint_c=round(setpoint_c, 3),  # binary32 holds no more
            power_w=round(power_w, 3),
            on="on" in status,
            watchdog_armed="watchdog_armed" in status,
            alarm=maps.HEATER_ALARMS[number] if known else f"alarm {number}",
            time_s=asyncio.get_running_loop().time(),
        )
