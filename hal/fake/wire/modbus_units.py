"""Modbus units with the fake devices behind their registers: what they share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from hal.bus.modbus_server import Refusal, Silence
from hal.codec import maps
from hal.codec.modbus import READ_COILS, READ_HOLDING, READ_INPUT, WRITE_COIL, ExceptionCode, Request
from hal.codec.registers import Block, Image, RegisterError, RegisterField
from hal.errors import DeviceError, DeviceFault, DeviceTimeout, NotConnected, SafetyError
from hal.fake.faults import FaultBook
from hal.interfaces import Identity


class Part:
    """One device's registers, from 0 on. `writable` are those that may be written; the rest is read back from the fake.

    A part acts only through its fake, so that it obeys the same limits, errors and faults.
    """

    writable: range = range(0)

    def __init__(self, fake: Any, faults: FaultBook, size: int) -> None:
        self.fake = fake
        self.words = [0] * size
        self._faults = faults
        self._identity: Identity | None = None

    @property
    def name(self) -> str:
        """The device's name in the cell file."""
        return str(self.fake.name)

    async def identity(self) -> Identity:
        """Who the device is."""
        if self._identity is not None:
            await self.gate("identity")
        return await self.ready()

    async def ready(self) -> Identity:
        """Connect the fake when it is first needed."""
        if self._identity is None:
            self._identity = await self.fake.connect()
        return self._identity

    async def gate(self, command: str) -> None:
        """Pass, or fail as the device would."""
        await self._faults.gate(self.name, command)

    async def close(self) -> None:
        """Nothing goes on."""
        if self._identity is not None:
            self._identity = None
            await self.fake.close()

    async def refresh(self) -> None:
        """Bring what can be read up to date."""
        await self.gate("read")

    async def written(self, at: int, before: list[int]) -> None:
        """Registers from `at` on have been written over `before`, the words of the whole part; act on it."""
        await self.gate("write")

    def put(self, block: Block, values: Mapping[RegisterField[Any], Any]) -> None:
        """Set a block's registers."""
        self.words[block.start : block.start + block.size] = block.encode(values)

    def get(self, field: RegisterField[Any]) -> Any:
        """What a field's registers say."""
        return Image(0, tuple(self.words))[field]


class Unit:
    """Parts by their base register, and the identity of the first of them."""

    def __init__(self, parts: Mapping[int, Part]) -> None:
        self.parts = dict(parts)
        self._lock = asyncio.Lock()

    async def close(self) -> None:
        """Close every part."""
        for part in self.parts.values():
            await part.close()

    async def answer(self, request: Request) -> tuple[int, ...]:
        """Registers read, or nothing for a write; one after the other, as a device does."""
        async with self._lock:
            try:
                return await self._answer(request)
            except NotConnected:
                raise Refusal(ExceptionCode.GATEWAY_TARGET) from None
            except DeviceTimeout:
                raise Silence from None
            except DeviceFault:
                raise Refusal(ExceptionCode.DEVICE_FAILURE) from None
            except SafetyError:
                raise Refusal(ExceptionCode.BUSY) from None
            except (DeviceError, RegisterError):
                raise Refusal(ExceptionCode.ILLEGAL_VALUE) from None

    async def _answer(self, request: Request) -> tuple[int, ...]:
        if request.function in (READ_COILS, WRITE_COIL):
            raise Refusal(ExceptionCode.ILLEGAL_FUNCTION)
        if request.address >= maps.IDENTITY.start:
            return await self._who(request)
        base, part = self._part(request)
        await part.ready()
        at = request.address - base
        if request.function in (READ_HOLDING, READ_INPUT):
            await part.refresh()
            return tuple(part.words[at : at + request.count])
        if at not in part.writable or at + request.count - 1 not in part.writable:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        before = list(part.words)
        part.words[at : at + request.count] = request.words
        try:
            await part.written(at, before)
        except BaseException:
            part.words[at : at + request.count] = before[at : at + request.count]
            raise
        return ()

    async def _who(self, request: Request) -> tuple[int, ...]:
        begin = request.address - maps.IDENTITY.start
        if request.function not in (READ_HOLDING, READ_INPUT) or begin + request.count > maps.IDENTITY.size:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        who = await next(iter(self.parts.values())).identity()
        words = maps.IDENTITY.encode(
            {maps.VENDOR: who.vendor, maps.MODEL: who.model, maps.SERIAL: who.serial, maps.FIRMWARE: who.firmware}
        )
        return words[begin : begin + request.count]

    def _part(self, request: Request) -> tuple[int, Part]:
        for base, part in self.parts.items():
            if base <= request.address and request.address + request.count <= base + len(part.words):
                return base, part
        raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)


class UnitsByNumber:
    """The units behind one server. An unknown number: no answer on a serial line, exception 11 through a gateway."""

    def __init__(self, units: Mapping[int, Unit], *, serial: bool) -> None:
        self._units = dict(units)
        self._serial = serial

    async def answer(self, request: Request) -> tuple[int, ...]:
        """As the unit asked answers."""
        unit = self._units.get(request.unit)
        if unit is not None:
            return await unit.answer(request)
        if self._serial:
            raise Silence
        raise Refusal(ExceptionCode.GATEWAY_TARGET)

    async def close(self) -> None:
        """Close every unit."""
        for unit in self._units.values():
            await unit.close()


class Watchdog:
    """Calls `trip` where it has not been fed for its time; 0 s is never."""

    def __init__(self, trip: Callable[[], None]) -> None:
        self._trip = trip
        self._timer: asyncio.TimerHandle | None = None

    def feed(self, seconds: float) -> None:
        """Start anew."""
        self.stop()
        if seconds > 0.0:
            self._timer = asyncio.get_running_loop().call_later(seconds, self._trip)

    def stop(self) -> None:
        """Watch no longer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
