"""Thermocouple module, pyrometer, gap probes and heater controller as Modbus registers."""

from __future__ import annotations

import asyncio
import dataclasses
import math
from typing import Any

from hal.codec import maps
from hal.codec.registers import Bits, Block, RegisterField, Scaled
from hal.fake.devices.heating import thermal_of
from hal.fake.faults import FaultBook
from hal.fake.heat.control import HeaterControl
from hal.fake.plant import Plant
from hal.fake.wire.modbus_units import Part
from hal.interfaces import HeaterState, Quality, Reading


class MeasuringPart(Part):
    """A value, a status, and a counter that grows when there is another conversion."""

    def __init__(
        self, fake: Any, faults: FaultBook, block: Block, value: RegisterField[float], status: Bits, counter: Scaled
    ) -> None:
        super().__init__(fake, faults, block.size)
        self._value, self._status, self._counter = value, status, counter
        self._time_s = -math.inf
        self._count = 0

    async def refresh(self) -> None:
        """One conversion, unless the sensor gives its last one again."""
        reading: Reading = await self.fake.read()
        if reading.time_s != self._time_s:
            self._time_s, self._count = reading.time_s, (self._count + 1) & 0xFFFF
        status: set[str] = set()
        value = reading.value
        if math.isnan(value):
            status, value = {maps.OPEN_CIRCUIT}, 0.0
        elif reading.quality is not Quality.GOOD:
            status = {maps.OUT_OF_RANGE}
        fields: tuple[tuple[RegisterField[Any], Any], ...] = (
            (self._value, value),
            (self._status, frozenset(status)),
            (self._counter, self._count),
        )
        for field, said in fields:
            self.words[field.at : field.at + field.size] = field.encode(said)


def thermocouple(fake: Any, faults: FaultBook, plant: Plant) -> Part:
    """One channel of a thermocouple module."""
    return MeasuringPart(fake, faults, maps.THERMOCOUPLE, maps.TC_VALUE, maps.TC_STATUS, maps.TC_COUNTER)


def pyrometer(fake: Any, faults: FaultBook, plant: Plant) -> Part:
    """A pyrometer, with the emissivity that is set on it."""
    part = MeasuringPart(fake, faults, maps.PYROMETER, maps.PYRO_VALUE, maps.PYRO_STATUS, maps.PYRO_COUNTER)
    field = maps.PYRO_EMISSIVITY
    part.words[field.at : field.at + field.size] = field.encode(thermal_of(plant).imperfections.set_emissivity)
    return part


def gap_probe(fake: Any, faults: FaultBook, plant: Plant) -> Part:
    """A gap probe."""
    return MeasuringPart(fake, faults, maps.GAP_PROBE, maps.GAP_VALUE, maps.GAP_STATUS, maps.GAP_COUNTER)


class HeaterPart(Part):
    """The plant's heater controller: orders, run word, watchdog time, reset.

    With a watchdog time set, each request that is answered feeds the watchdog; the controller itself trips by it.
    """

    writable = range(maps.HEATER_ORDER.start, maps.HEATER_SIZE)

    def __init__(self, fake: Any, faults: FaultBook, plant: Plant) -> None:
        super().__init__(fake, faults, maps.HEATER_SIZE)
        self._plant = plant

    async def refresh(self) -> None:
        """What the controller says of itself, the time before this request included."""
        state: HeaterState = await self.fake.read()
        now = asyncio.get_running_loop().time()
        self._feed(now)
        status = {"on"} if state.on else set()
        if self.get(maps.HEATER_WATCHDOG_S) > 0.0:
            status.add("watchdog_armed")
        if not self._faults.power_cut(now):
            status.add("supply")
        self.put(
            maps.HEATER_STATE,
            {
                maps.HEATER_SETPOINT: state.setpoint_c,
                maps.HEATER_POWER: state.power_w,
                maps.HEATER_STATUS: frozenset(status),
                maps.HEATER_ALARM: _alarm_number(state.alarm),
            },
        )

    async def written(self, at: int, before: list[int]) -> None:
        """Orders are kept until `run` is written; the other words act at once."""
        if at == maps.HEATER_RUN_WORD.at:
            await self._run()
        elif at == maps.HEATER_RESET_WORD.at:
            await self.fake.rearm()
        else:
            await self.gate("order")
            now = asyncio.get_running_loop().time()
            self._plant.advance(now)
            if at == maps.ORDER_SETPOINT.at and self._faults.active(self.name, "setpoint_not_taken", now):
                place = slice(at, at + maps.ORDER_SETPOINT.size)
                self.words[place] = before[place]
        self._feed(asyncio.get_running_loop().time())

    async def _run(self) -> None:
        if self.get(maps.HEATER_RUN_WORD) == 0:
            await self.fake.off()
            return
        await self.fake.heat(
            self.get(maps.ORDER_SETPOINT),
            ramp_k_per_min=self.get(maps.ORDER_RAMP),
            max_power_w=self.get(maps.ORDER_LIMIT),
        )

    def _feed(self, now: float) -> None:
        control = thermal_of(self._plant).source
        if isinstance(control, HeaterControl):
            control.link_lost_s = math.inf
            if (watchdog_s := self.get(maps.HEATER_WATCHDOG_S)) > 0.0:
                control.settings = dataclasses.replace(control.settings, watchdog_s=watchdog_s)
                control.link_lost_s = now


def _alarm_number(alarm: str) -> int:
    """The number of the alarm whose text `alarm` begins with."""
    if not alarm:
        return 0
    known = maps.HEATER_ALARMS
    return next((number for number, text in enumerate(known) if text and alarm.startswith(text)), len(known) - 1)
