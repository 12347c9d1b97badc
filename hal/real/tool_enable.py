"""The output that lets the guns turn, at a remote I/O coupler on Modbus."""

from __future__ import annotations

import asyncio

from hal.bus.modbus import Lines
from hal.codec import maps
from hal.codec.registers import Block, Image
from hal.entries import ModbusEnableEntry
from hal.errors import DeviceFault, SafetyOpen
from hal.interfaces import EnableState, SafeState
from hal.real.modbus import ModbusDevice

OUTPUT = Block((maps.ENABLE_OUT,))
ON: frozenset[str] = frozenset(maps.ENABLE_OUT.bits)


class ToolEnable(ModbusDevice):
    """Implements `hal.interfaces.EnableOutput`. The output is set only while the watchdog was read back armed."""

    def __init__(self, name: str, entry: ModbusEnableEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines)
        self._watchdog_s = entry.watchdog_s
        self._writing = asyncio.Lock()
        self._set = False

    async def allow(self) -> None:
        """Set the output, or prove that it is set: being asked feeds the watchdog."""
        async with self._writing:
            image = await self._image()
            if "supply" not in self._value(image, maps.ENABLE_IN):
                raise SafetyOpen("no power at the output: the safety circuit is open", device=self.name)
            if self._set and not self._enabled(image):
                raise DeviceFault("the coupler has dropped it: it heard nothing for too long", device=self.name)
            if not self._set:
                if self._value(image, maps.IO_WATCHDOG_S) != self._watchdog_s:
                    await self._write(maps.IO_WATCHDOG, {maps.IO_WATCHDOG_S: self._watchdog_s})
                await self._write(OUTPUT, {maps.ENABLE_OUT: ON})
                self._set = True

    async def read(self) -> EnableState:
        """As the coupler says."""
        image = await self._image()
        enabled, inputs = self._enabled(image), self._value(image, maps.ENABLE_IN)
        reason = "no power" if "supply" not in inputs else "dropped by the coupler" if self._set else "not asked for"
        return EnableState(enabled, "" if enabled else reason, asyncio.get_running_loop().time())

    async def halt(self) -> None:
        """Off, read back."""
        async with self._writing:
            self._set = False
            await self._write(OUTPUT, {maps.ENABLE_OUT: frozenset()})

    async def safe(self) -> SafeState:
        """Safe while the coupler says that the output is off."""
        enabled = self._enabled(await self._image())
        return SafeState(not enabled, "the guns may turn" if enabled else "the guns may not turn")

    async def rearm(self) -> None:
        """Off: nothing turns on by itself."""
        await self.halt()

    async def close(self) -> None:
        """Let go of the line; an output that is still set falls with the watchdog."""
        self._set = False
        await super().close()

    async def _image(self) -> Image:
        return await self._read(maps.ENABLE)

    def _enabled(self, image: Image) -> bool:
        return self._value(image, maps.ENABLE_OUT) == ON and "dropped" not in self._value(image, maps.ENABLE_IN)
