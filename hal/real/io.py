"""Chuck, camera arm, nut feeder and the mirror of the safety circuit over remote I/O on Modbus."""

from __future__ import annotations

import asyncio
from typing import Literal

from hal.bus.modbus import Lines
from hal.codec import maps
from hal.codec.registers import Image
from hal.entries import ModbusEntry, ModbusStrokeEntry
from hal.errors import DeviceFault, DeviceRefused
from hal.interfaces import ChuckState, ParkState, SafeState, SafetyState
from hal.real.modbus import ModbusDevice
from hal.real.stroke import StrokeDevice

JAWS = frozenset(("clamped_1", "clamped_2", "open"))


class Chuck(StrokeDevice):
    """A self-locking chuck: two valves, three end switches, a pressure. Implements `hal.interfaces.Chuck`."""

    def __init__(self, name: str, entry: ModbusStrokeEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines, maps.CHUCK, maps.CHUCK_OUT, maps.CHUCK_IN)

    async def read(self) -> ChuckState:
        """Both feedbacks and the pressure."""
        return self._state(await self._image())

    async def clamp(self) -> ChuckState:
        """Close the jaws. Raises DeviceFault where the feedbacks do not both come."""
        return await self._to("clamp", clamped=True)

    async def release(self) -> ChuckState:
        """Open the jaws. Raises DeviceFault where a feedback stays."""
        return await self._to("release", clamped=False)

    async def _to(self, output: str, *, clamped: bool) -> ChuckState:
        def arrived(image: Image) -> bool:
            inputs = self._value(image, maps.CHUCK_IN)
            return inputs & JAWS == (JAWS - {"open"} if clamped else {"open"})

        image = await self._powered()
        if not arrived(image) or self._under_way:
            image = await self._move(output, arrived)
        if not arrived(image):
            state = self._state(image)
            text = f"feedbacks {state.clamped_1:d} and {state.clamped_2:d} after {output}"
            raise DeviceFault(f"{text} and {self._stroke_s:g} s", device=self.name)
        return self._state(image)

    def _state(self, image: Image) -> ChuckState:
        inputs = self._value(image, maps.CHUCK_IN)
        now = asyncio.get_running_loop().time()
        pressure = self._value(image, maps.CHUCK_PRESSURE)
        return ChuckState("clamped_1" in inputs, "clamped_2" in inputs, pressure, now)


class CameraPark(StrokeDevice):
    """The camera's arm: an output and an end switch for each place. Implements `hal.interfaces.CameraPark`."""

    def __init__(self, name: str, entry: ModbusStrokeEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines, maps.PARK, maps.PARK_OUT, maps.PARK_IN)

    async def read(self) -> ParkState:
        """The end switch that is set; None between them or where two are."""
        return self._state(await self._image())

    async def go(self, position: Literal["parked", "rotor", "shaft"]) -> ParkState:
        """Swing to `position`. Raises DeviceFault where the arm does not arrive, Interrupted when halted."""
        if position not in maps.PARK_PLACES:
            raise DeviceRefused(f"no position {position!r}", device=self.name)
        image = await self._powered()
        if self._state(image).position != position or self._under_way:
            image = await self._move(position, lambda image: self._state(image).position == position)
        state = self._state(image)
        if state.position != position:
            raise DeviceFault(f"end switches do not say {position} after {self._stroke_s:g} s", device=self.name)
        return state

    def _state(self, image: Image) -> ParkState:
        inputs = self._value(image, maps.PARK_IN)
        places: list[Literal["parked", "rotor", "shaft"]] = [
            place for place in ("parked", "rotor", "shaft") if place in inputs
        ]
        return ParkState(places[0] if len(places) == 1 else None, asyncio.get_running_loop().time())


class NutFeeder(StrokeDevice):
    """A slide to each gun's socket, with a presence sensor there. Implements `hal.interfaces.NutFeeder`."""

    def __init__(self, name: str, entry: ModbusStrokeEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines, maps.FEEDER, maps.FEEDER_OUT, maps.FEEDER_IN)

    async def count(self) -> int:
        """Nuts in the magazine, as its counter says."""
        return self._integer(await self._image(), maps.FEEDER_COUNT)

    async def load(self, gun: Literal["a", "b"]) -> bool:
        """One nut into the socket of `gun`; whether the presence sensor sees it.

        Raises DeviceRefused (guns not back, socket full), DeviceFault (the slide does not arrive), Interrupted.
        """
        slide = f"slide_{gun}"
        inputs = self._value(await self._powered(), maps.FEEDER_IN)
        if "guns_back" not in inputs:
            raise DeviceRefused("the guns are not back", device=self.name)
        if f"nut_{gun}" in inputs:
            raise DeviceRefused(f"the socket of gun {gun} holds a nut already", device=self.name)
        if slide in self._under_way:
            raise DeviceRefused(f"the slide of gun {gun} is on its way already", device=self.name)
        image = await self._move(slide, lambda image: f"out_{gun}" in self._value(image, maps.FEEDER_IN))
        inputs = self._value(image, maps.FEEDER_IN)
        if f"out_{gun}" not in inputs:
            raise DeviceFault(f"the slide of gun {gun} does not arrive in {self._stroke_s:g} s", device=self.name)
        return f"nut_{gun}" in inputs

    def _rivals(self, output: str) -> frozenset[str]:
        """The two slides do not meet."""
        return frozenset((output,))


LIFE_S = 1.0
"""The safety controller counts ten times a second; a mirror that stands still for so long is not believed."""


class SafetyInputs(ModbusDevice):
    """Mirror of the hard-wired circuit. Implements `hal.interfaces.SafetyInputs`.

    Channels that disagree, and every input of a mirror that no longer counts, are unknown: that counts as tripped.
    """

    def __init__(self, name: str, entry: ModbusEntry, lines: Lines) -> None:
        super().__init__(name, entry, lines)
        self._life: tuple[float, float] | None = None
        self._resets = 0

    async def read(self) -> SafetyState:
        """The inputs as they are."""
        image = await self._read(maps.SAFETY_MIRROR)
        now = asyncio.get_running_loop().time()
        if not self._lives(self._value(image, maps.SAFETY_COUNTER), now):
            return SafetyState(None, None, None, None, None, now)
        inputs = self._value(image, maps.SAFETY_IN)
        return SafetyState(
            estop_released=_agreed(inputs, "estop"),
            guards_closed=_agreed(inputs, "guards"),
            sto_released=_agreed(inputs, "sto"),
            bench_locked="bench_locked" in inputs,
            bench_moved="bench_moved" in inputs,
            time_s=now,
        )

    async def close(self) -> None:
        """Let go of the line."""
        self._life = None
        await super().close()

    async def halt(self) -> None:
        """Nothing moves here; the exchange proves that the device answers."""
        await self._read(maps.SAFETY_MIRROR)

    async def safe(self) -> SafeState:
        """Safe once it answers: it moves nothing."""
        await self._read(maps.SAFETY_MIRROR)
        return SafeState(True, "moves nothing")

    async def rearm(self) -> None:
        """Have the latch of a moved bench cleared where its cause is gone."""
        self._resets = self._resets % 0xFFFF + 1
        await self._write(maps.SAFETY_RESET, {maps.SAFETY_RESET_WORD: self._resets})

    def _lives(self, count: float, now: float) -> bool:
        if self._life is None or self._life[0] != count:
            self._life = (count, now)
        return now - self._life[1] < LIFE_S


def _agreed(inputs: frozenset[str], pair: str) -> bool | None:
    """What both channels say; None where they disagree."""
    first, second = f"{pair}_1" in inputs, f"{pair}_2" in inputs
    return first if first == second else None
