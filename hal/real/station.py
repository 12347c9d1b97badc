"""The part station over Modbus: an order with a job number, and the serial numbers that were read."""

from __future__ import annotations

import asyncio

from hal.bus.modbus import Lines
from hal.codec import maps
from hal.codec.registers import Image
from hal.entries import ModbusStationEntry
from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted
from hal.interfaces import SafeState
from hal.real.modbus import ModbusDevice

LOOK_S = 0.5


class PartStation(ModbusDevice):
    """Implements `hal.interfaces.PartStation`. Job 0 is none: writing it ends what is under way."""

    def __init__(self, name: str, entry: ModbusStationEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines)
        self._present_s = entry.present_s
        self._halted = asyncio.Event()

    async def present(self, rotor: str, shaft: str) -> tuple[str, str]:
        """Serial numbers as read on the parts. Raises DeviceRefused (jack up), DeviceFault, Interrupted."""
        job = self._integer(await self._read(maps.STATION_ANSWER), maps.ANSWERED_JOB) % 0xFFFF + 1
        await self._write(maps.STATION_WANTED, {maps.WANTED_ROTOR: rotor, maps.WANTED_SHAFT: shaft})
        self._halted = asyncio.Event()
        await self._write(maps.STATION_JOB, {maps.STATION_JOB_WORD: job})
        image = await self._answered(job, self._halted)
        result = self._integer(image, maps.STATION_RESULT)
        if result == maps.STATION_JACK_UP:
            raise DeviceRefused("the jack is not down: parts go in at 0 mm", device=self.name)
        if result == maps.STATION_UNREADABLE:
            raise DeviceFault("a serial number cannot be read", device=self.name)
        if result != maps.STATION_DONE:
            raise DeviceFault(f"the station failed (result {result})", device=self.name)
        return self._value(image, maps.READ_ROTOR), self._value(image, maps.READ_SHAFT)

    async def halt(self) -> None:
        """End the job, read back."""
        self._halted.set()
        await self._write(maps.STATION_JOB, {maps.STATION_JOB_WORD: 0})

    async def safe(self) -> SafeState:
        """Safe while no job is under way."""
        busy = self._value(await self._read(maps.STATION_ANSWER), maps.STATION_RESULT) == maps.STATION_BUSY
        return SafeState(not busy, "presents parts" if busy else "waits")

    async def rearm(self) -> None:
        """No job goes on by itself."""
        await self._write(maps.STATION_JOB, {maps.STATION_JOB_WORD: 0})

    async def _answered(self, job: int, halted: asyncio.Event) -> Image:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + self._present_s
        while True:
            image = await self._read(maps.STATION_ANSWER)
            if halted.is_set():
                raise Interrupted("halted on the way", device=self.name)
            answered = self._value(image, maps.ANSWERED_JOB) == job
            if answered and self._value(image, maps.STATION_RESULT) != maps.STATION_BUSY:
                return image
            if loop.time() >= end_s:
                raise DeviceTimeout(f"no parts after {self._present_s:g} s", device=self.name)
            await asyncio.sleep(LOOK_S)
