"""Fake supply of parts: the station that presents rotor and shaft, and the feeder that puts nuts into sockets."""

from __future__ import annotations

import asyncio
from typing import Literal, Protocol, runtime_checkable

from hal.errors import ConfigError, DeviceFault, DeviceRefused
from hal.fake.devices.io import IoDevice, Stroke
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.interfaces import SafeState

JACK_LOW_MM = 1.0
"""Parts go in with the jack no higher than this."""
SPARE = 4
"""Nuts in the magazine beyond those of one joint."""
GUNS_BACK_MM = 1.0
"""Guns are loaded at or below this feed."""


class FakePartStation(IoDevice):
    """Implements `hal.interfaces.PartStation`: the plant gets the parts of these serial numbers, unclamped."""

    model = "part station"

    async def present(self, rotor: str, shaft: str) -> tuple[str, str]:
        """Serial numbers as read on the parts. Raises DeviceRefused (jack up), DeviceFault (code unreadable)."""
        now = await self._exchange("present")
        height = self._plant.motion["jack"].position(now)
        if height > JACK_LOW_MM:
            raise DeviceRefused(f"the jack stands at {height:.1f} mm, parts go in at 0 mm", device=self.name)
        await asyncio.sleep(self._plant.numbers.properties.part_exchange_s)
        now = await self._exchange("present")
        if self._faults.active(self.name, "unreadable", now):
            raise DeviceFault("a serial number cannot be read", device=self.name)
        if self._faults.active(self.name, "wrong_serial", now):
            shaft = f"{shaft}-other"
        self._plant.set_chuck(clamped=False)
        self._plant.load_parts(rotor, shaft)
        return rotor, shaft


@runtime_checkable
class Sockets(Protocol):
    """What the feeder needs of the plant's joints: the sockets of the two guns."""

    def socket_has_nut(self, gun: Literal["a", "b"]) -> bool: ...
    def load_nut(self, gun: Literal["a", "b"]) -> None: ...


class FakeNutFeeder(IoDevice):
    """Implements `hal.interfaces.NutFeeder`. New parts come with a full magazine."""

    model = "nut feeder"

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        super().__init__(name, plant, faults)
        self._full = plant.geometry.count + SPARE
        self._filled_for = plant.shaft
        self._left = self._full
        self._strokes: dict[str, Stroke] = {"a": Stroke(), "b": Stroke()}

    async def count(self) -> int:
        """Nuts in the magazine, as its counter says."""
        now = await self._exchange("count")
        off = self._faults.active(self.name, "miscount", now)
        return max(0, self._in_magazine(now) + (round(off.number) if off else 0))

    async def load(self, gun: Literal["a", "b"]) -> bool:
        """One nut into the socket of `gun`; whether the presence sensor sees it.

        Raises DeviceRefused (guns not back, socket full), Interrupted when halted on the way.
        """
        now = await self._powered("load")
        feed = self._plant.motion["gun_feed"].position(now)
        if feed > GUNS_BACK_MM:
            raise DeviceRefused(f"the guns stand at {feed:.1f} mm, not back", device=self.name)
        sockets = self._sockets()
        if sockets.socket_has_nut(gun):
            raise DeviceRefused(f"the socket of gun {gun} holds a nut already", device=self.name)
        await self._strokes[gun].run(self._plant.numbers.properties.nut_load_s, device=self.name)
        now = await self._exchange("load")
        if self._in_magazine(now) == 0 or self._faults.take(self.name, "missing_nut", now):
            return False
        self._left -= 1
        sockets.load_nut(gun)
        return True

    async def halt(self) -> None:
        """Stop the slides."""
        await self._exchange("halt")
        for stroke in self._strokes.values():
            stroke.halt()

    async def safe(self) -> SafeState:
        """Safe while the slides stand."""
        await self._exchange("safe")
        moving = any(stroke.under_way for stroke in self._strokes.values())
        return SafeState(not moving, "a slide moves" if moving else "slides stand")

    def _sockets(self) -> Sockets:
        joints = self._plant.joints
        if not isinstance(joints, Sockets):
            raise ConfigError("the plant has no sockets", place=f"devices.{self.name}")
        return joints

    def _in_magazine(self, now: float) -> int:
        if self._plant.shaft is not self._filled_for:
            self._filled_for, self._left = self._plant.shaft, self._full
        return 0 if self._faults.active(self.name, "empty", now) else self._left
