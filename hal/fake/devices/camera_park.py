"""Fake camera arm: swings the camera between its two views and its park position."""

from __future__ import annotations

from typing import Literal

from hal.errors import DeviceFault, DeviceRefused
from hal.fake.devices.io import IoDevice, Stroke
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.interfaces import ParkState, SafeState

Position = Literal["parked", "rotor", "shaft"]


class FakeCameraPark(IoDevice):
    """Implements `hal.interfaces.CameraPark`. The arm's place is the plant's; end switches say where it is."""

    model = "camera arm"

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        super().__init__(name, plant, faults)
        self._stroke = Stroke()

    async def read(self) -> ParkState:
        """The end switch that is set; None between them or where two are."""
        return self._image(await self._answer("read"))

    async def go(self, position: Position) -> ParkState:
        """Swing to `position`. Raises DeviceFault where the arm does not arrive, Interrupted when halted."""
        if position not in ("parked", "rotor", "shaft"):
            raise DeviceRefused(f"no position {position!r}", device=self.name)
        now = await self._powered("go")
        if self._plant.camera != position:
            self._plant.camera = "moving"
            await self._stroke.run(self._plant.numbers.properties.camera_swing_s, device=self.name)
            now = await self._exchange("go")
            if self._faults.active(self.name, "stuck_between", now):
                raise DeviceFault(f"no end switch on the way to {position}", device=self.name)
            self._plant.camera = position
        state = self._image(now)
        if state.position != position:
            raise DeviceFault(f"end switches do not say {position}", device=self.name)
        return state

    async def halt(self) -> None:
        """Stop the arm where it is."""
        await self._exchange("halt")
        self._stroke.halt()

    async def safe(self) -> SafeState:
        """Safe while the arm stands, wherever that is."""
        await self._exchange("safe")
        moving = self._stroke.under_way
        return SafeState(not moving, "the arm swings" if moving else f"the arm stands ({self._plant.camera})")

    def _image(self, now: float) -> ParkState:
        place = self._plant.camera
        if place == "moving" or self._faults.active(self.name, "disagree", now):
            return ParkState(None, now)
        return ParkState(place, now)
