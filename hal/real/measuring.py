"""Measuring devices on Modbus lines: what thermometers and gap probes share."""

from __future__ import annotations

import asyncio
import math

from hal.bus.modbus import Lines
from hal.codec import maps
from hal.codec.registers import Bits, Block, RegisterField, Scaled
from hal.entries import ModbusEntry
from hal.interfaces import Quality, Reading, SafeState
from hal.real.modbus import ModbusDevice


class Measuring(ModbusDevice):
    """One measured value with its status and a counter of conversions.

    A reading has the time at which its conversion was first seen: a device that no longer converts gives old times.
    """

    def __init__(
        self,
        name: str,
        entry: ModbusEntry,
        lines: Lines,
        block: Block,
        value: RegisterField[float],
        status: Bits,
        counter: Scaled,
    ) -> None:
        super().__init__(name, entry, lines)
        self._block, self._field, self._status, self._counter = block, value, status, counter
        self._seen: tuple[float, float] | None = None

    async def read(self) -> Reading:
        """The value; BAD where the device says so, NaN where it has none."""
        image = await self._read(self._block)
        count, now = self._value(image, self._counter), asyncio.get_running_loop().time()
        if self._seen is None or self._seen[0] != count:
            self._seen = (count, now)
        status = self._value(image, self._status)
        value = math.nan if maps.OPEN_CIRCUIT in status else self._value(image, self._field)
        good = math.isfinite(value) and not status
        return Reading(value, self._seen[1], Quality.GOOD if good else Quality.BAD)

    async def close(self) -> None:
        """Let go of the line; what was seen before is no longer known."""
        self._seen = None
        await super().close()

    async def halt(self) -> None:
        """Nothing moves here; the exchange proves that the device answers."""
        await self._read(self._block)

    async def safe(self) -> SafeState:
        """Safe once it answers."""
        await self._read(self._block)
        return SafeState(True, "moves nothing")

    async def rearm(self) -> None:
        """No set-point to be changed."""
        await self._read(self._block)


class GapProbe(Measuring):
    """Implements `hal.interfaces.GapProbe`."""

    def __init__(self, name: str, entry: ModbusEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines, maps.GAP_PROBE, maps.GAP_VALUE, maps.GAP_STATUS, maps.GAP_COUNTER)
