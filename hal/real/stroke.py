"""What is moved by outputs of a remote I/O coupler and tells by its inputs where it is."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from hal.bus.modbus import Lines
from hal.codec import maps
from hal.codec.registers import Bits, Block, Image
from hal.entries import ModbusStrokeEntry
from hal.errors import DeviceFault, Interrupted, SafetyOpen
from hal.interfaces import SafeState
from hal.real.modbus import ModbusDevice

LOOK_S = 0.05
"""How often the inputs are looked at while something moves; this feeds the coupler's watchdog."""


class StrokeDevice(ModbusDevice):
    """Outputs, inputs and a watchdog in one block. An output is set only while the watchdog was read back armed,
    for as long as the motion takes; where the controller dies, the coupler drops it."""

    def __init__(
        self, name: str, entry: ModbusStrokeEntry, lines: Lines, block: Block, out: Bits, inputs: Bits
    ) -> None:
        super().__init__(name, entry, lines)
        self._stroke_s, self._watchdog_s = entry.stroke_s, entry.watchdog_s
        self._block, self._out, self._in = block, out, inputs
        self._outputs: frozenset[str] = frozenset()
        self._writing = asyncio.Lock()
        self._under_way: dict[str, asyncio.Event] = {}

    async def halt(self) -> None:
        """All outputs off, read back; what moves is interrupted."""
        for halted in self._under_way.values():
            halted.set()
        await self._set(off=frozenset(self._out.bits))

    async def safe(self) -> SafeState:
        """Safe while the device says that no output is set."""
        outputs = self._value(await self._image(), self._out)
        return SafeState(not outputs, f"moves ({', '.join(sorted(outputs))})" if outputs else "stands, outputs off")

    async def rearm(self) -> None:
        """No output is set: nothing goes on by itself."""
        await self._set(off=frozenset(self._out.bits))

    async def _settle(self) -> None:
        await self._arm()

    async def _image(self) -> Image:
        return await self._read(self._block)

    async def _powered(self) -> Image:
        """The inputs. Raises SafetyOpen while the outputs have no power."""
        image = await self._image()
        if "supply" not in self._value(image, self._in):
            raise SafetyOpen("no power at the outputs: the safety circuit is open", device=self.name)
        return image

    async def _arm(self) -> None:
        """Set the coupler's watchdog where it is not set so."""
        if self._value(await self._image(), maps.IO_WATCHDOG_S) != self._watchdog_s:
            await self._write(maps.IO_WATCHDOG, {maps.IO_WATCHDOG_S: self._watchdog_s})

    async def _set(self, *, on: frozenset[str] = frozenset(), off: frozenset[str] = frozenset()) -> None:
        async with self._writing:
            self._outputs = (self._outputs - off) | on
            await self._write(Block((self._out,)), {self._out: self._outputs})

    async def _move(self, output: str, arrived: Callable[[Image], bool]) -> Image:
        """Set `output` until `arrived`, or until the time for it is up; returns the inputs then seen.

        Raises Interrupted (halted), SafetyOpen (no power), DeviceFault (the coupler has dropped its outputs).
        """
        await self._powered()
        await self._arm()
        rivals = self._rivals(output)
        for other in self._under_way.keys() & rivals:
            self._under_way[other].set()
        halted = self._under_way[output] = asyncio.Event()
        try:
            await self._set(on=frozenset((output,)), off=rivals)
            image = await self._watch(output, arrived, halted)
            await self._set(off=frozenset((output,)))
        except Interrupted:
            raise
        except BaseException:
            self._line.errand(lambda: self._set(off=frozenset((output,))))  # not here: this task may be on its way out
            raise
        finally:
            if self._under_way.get(output) is halted:
                del self._under_way[output]
        return image

    def _rivals(self, output: str) -> frozenset[str]:
        """Outputs that must never be set together with `output`, itself included."""
        return frozenset(self._out.bits)

    async def _watch(self, output: str, arrived: Callable[[Image], bool], halted: asyncio.Event) -> Image:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + self._stroke_s
        while True:
            image = await self._image()
            if halted.is_set():
                raise Interrupted("halted on the way", device=self.name)
            if arrived(image) or loop.time() >= end_s:
                return image
            if "supply" not in self._value(image, self._in):
                raise SafetyOpen("no power at the outputs: the safety circuit has opened", device=self.name)
            if output not in self._value(image, self._out):
                raise DeviceFault(f"the coupler has dropped {output}: it heard nothing for too long", device=self.name)
            await asyncio.sleep(LOOK_S)
