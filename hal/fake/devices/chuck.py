"""Fake chuck: a power chuck on the plant, with two feedbacks and a pressure."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from hal.errors import DeviceFault
from hal.fake.devices.io import IoDevice, Stroke
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.interfaces import ChuckState, Identity, SafeState


@dataclass(frozen=True, slots=True)
class ChuckData:
    """A hydraulic three-jaw power chuck with a self-locking cylinder. Jaws hold above `holds_above_bar`."""

    pressure_bar: float = 6.0
    holds_above_bar: float = 3.0
    stroke_s: float = 1.5


class FakeChuck(IoDevice):
    """Implements `hal.interfaces.Chuck`. Self-locking: a halt or a lost link leaves the jaws as they are."""

    model = "chuck"

    def __init__(self, name: str, plant: Plant, faults: FaultBook, data: ChuckData | None = None) -> None:
        super().__init__(name, plant, faults)
        self._data = data or ChuckData()
        self._stroke = Stroke()
        self._unplanned: list[Callable[[], None]] = []

    async def connect(self) -> Identity:
        """Prove the device's identity."""
        identity = await super().connect()
        if not self._unplanned:
            self._unplanned = [
                self._faults.when(self.name, kind, self._lose_grip) for kind in ("opening", "pressure_drop")
            ]
        return identity

    async def close(self) -> None:
        """Drop the link."""
        await super().close()
        while self._unplanned:
            self._unplanned.pop()()

    async def read(self) -> ChuckState:
        """Both feedbacks and the pressure."""
        return self._image(await self._answer("read"))

    async def clamp(self) -> ChuckState:
        """Close the jaws. Raises DeviceFault where the feedbacks do not both come."""
        return await self._move("clamp", clamped=True)

    async def release(self) -> ChuckState:
        """Open the jaws. Raises DeviceFault where a feedback stays."""
        return await self._move("release", clamped=False)

    async def halt(self) -> None:
        """Stop the jaws."""
        await self._exchange("halt")
        self._stroke.halt()

    async def safe(self) -> SafeState:
        """Safe while the jaws stand."""
        await self._exchange("safe")
        moving = self._stroke.under_way
        return SafeState(not moving, "jaws move" if moving else "jaws stand")

    async def _move(self, command: str, *, clamped: bool) -> ChuckState:
        await self._powered(command)
        if self._plant.chuck_clamped != clamped:
            await self._stroke.run(self._data.stroke_s, device=self.name)
            self._plant.advance(asyncio.get_running_loop().time())
            self._plant.set_chuck(clamped=clamped)
        state = self._image(await self._exchange(command))
        if (state.clamped_1, state.clamped_2) != (clamped, clamped):
            raise DeviceFault(
                f"feedbacks {state.clamped_1:d} and {state.clamped_2:d} after {command}", device=self.name
            )
        return state

    def _pressure_bar(self, now: float) -> float:
        drop = self._faults.active(self.name, "pressure_drop", now)
        return drop.number if drop else self._data.pressure_bar

    def _lose_grip(self) -> None:
        """The jaws open where a fault opens them or the pressure no longer holds them."""
        now = asyncio.get_running_loop().time()
        opening = self._faults.active(self.name, "opening", now)
        if opening or self._pressure_bar(now) < self._data.holds_above_bar:
            self._plant.advance(now)
            self._plant.set_chuck(clamped=False)

    def _image(self, now: float) -> ChuckState:
        self._lose_grip()
        faults, pressure = self._faults, self._pressure_bar(now)
        held = self._plant.chuck_clamped and not self._stroke.under_way
        first, second = held, held
        if faults.active(self.name, "both_unset", now):
            first = second = False
        if faults.active(self.name, "disagree", now):
            second = not first
        return ChuckState(first, second, pressure, now)
