"""What all devices on Modbus lines share: identity, one block read in one exchange, every write read back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from hal.bus.modbus import Line, Lines, Link
from hal.codec import maps
from hal.codec.registers import Block, Image, RegisterError, RegisterField
from hal.entries import ModbusEntry
from hal.errors import DeviceError, DeviceFault, DeviceRefused, ImplausibleReading, NotConnected
from hal.interfaces import Identity

T = TypeVar("T")
Values = Mapping[RegisterField[Any], Any]


class ModbusDevice:
    """A name, a unit on a line, and the exchanges with it."""

    def __init__(self, name: str, entry: ModbusEntry, lines: Lines) -> None:
        self.name = name
        self._entry = entry
        self._line: Line = lines.to(_link(entry))
        self._identity: Identity | None = None

    async def connect(self) -> Identity:
        """Prove the unit's identity. Raises DeviceRefused where it is another than the cell file names."""
        if self._identity is not None:
            return self._identity
        await self._line.open(self)
        try:
            identity = await self._who()
            self._identity = identity
            await self._settle()
        except BaseException:
            await self.close()
            raise
        return identity

    async def close(self) -> None:
        """Let go of the line."""
        self._identity = None
        await self._line.close(self)

    async def _settle(self) -> None:
        """What else must hold before the device counts as connected."""

    async def _who(self) -> Identity:
        # The unit's own registers, whatever the device's base.
        words = await self._line.read(self._entry.unit, maps.IDENTITY.start, maps.IDENTITY.size, device=self.name)
        try:
            image = maps.IDENTITY.image(words)
            vendor, model, serial = image[maps.VENDOR], image[maps.MODEL], image[maps.SERIAL]
            identity = Identity(vendor, model, serial, image[maps.FIRMWARE], simulated=vendor == maps.SIMULATOR)
        except RegisterError as error:
            raise ImplausibleReading(str(error), device=self.name) from None
        if self._entry.serial not in ("", serial):
            raise DeviceRefused(f"serial number {serial}, expected {self._entry.serial}", device=self.name)
        return identity

    async def _read(self, block: Block) -> Image:
        """One block as it is on the device."""
        if self._identity is None:
            raise NotConnected("not connected", device=self.name)
        address = self._entry.base + block.start
        words = await self._line.read(self._entry.unit, address, block.size, device=self.name)
        return block.image(words)

    async def _write(self, block: Block, values: Values) -> None:
        """Write one block, once, and read it back. Raises DeviceRefused where a value does not fit."""
        words = await self._send(block, values)
        back = (await self._read(block)).words
        if back != words:
            names = ", ".join(field.name for field in block.fields)
            raise DeviceFault(f"{names} not taken: wrote {words}, read back {back}", device=self.name)

    async def _send(self, block: Block, values: Values) -> tuple[int, ...]:
        """As `_write`, where what is to be read back is the effect."""
        if self._identity is None:
            raise NotConnected("not connected", device=self.name)
        words = self._words(block, values)
        await self._line.write(self._entry.unit, self._entry.base + block.start, words, device=self.name)
        return words

    def _words(self, block: Block, values: Values) -> tuple[int, ...]:
        """Registers that say `values`. Raises DeviceRefused where one does not fit."""
        try:
            return block.encode(values)
        except RegisterError as error:
            raise DeviceRefused(str(error), device=self.name) from None

    def _value(self, image: Image, field: RegisterField[T]) -> T:
        """A field of `image`. Raises ImplausibleReading where the registers hold no such value."""
        try:
            return image[field]
        except RegisterError as error:
            raise ImplausibleReading(str(error), device=self.name) from None

    def _integer(self, image: Image, field: RegisterField[float]) -> int:
        """A field that counts or numbers."""
        value = self._value(image, field)
        return round(value)

    def _fault(self, reason: str) -> DeviceError:
        return DeviceFault(reason, device=self.name)


def _link(entry: ModbusEntry) -> Link:
    return Link(
        host=entry.host,
        port=entry.port,
        framing="rtu" if entry.port_path else entry.framing,
        port_path=entry.port_path,
        baud=entry.baud,
        parity=entry.parity,
        deadline_s=entry.deadline_s,
        worst_reply_s=entry.worst_reply_s,
    )
