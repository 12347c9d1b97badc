"""The fake output that lets the plant's guns turn: off until it is asked for, and off whenever it has no power."""

from __future__ import annotations

from collections.abc import Callable

from hal.errors import DeviceFault
from hal.fake.devices.io import IoDevice
from hal.fake.faults import POWER_CUTS, FaultBook
from hal.fake.plant import Plant
from hal.interfaces import EnableState, Identity, SafeState


class FakeToolEnable(IoDevice):
    """Implements `hal.interfaces.EnableOutput`. It has no watchdog: in one process it dies with whoever feeds it."""

    model = "tool enable"

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        super().__init__(name, plant, faults)
        self._on = False
        self._fallen = ""
        """Why it went off by itself; cleared where it is switched off."""
        self._unplanned: list[Callable[[], None]] = []

    async def connect(self) -> Identity:
        """Prove the device's identity. From here on the guns turn only while it is asked for."""
        identity = await super().connect()
        if not self._unplanned:
            self._unplanned = [self._faults.when(self.name, "dropped", lambda: self.fall("the coupler dropped it"))]
            self._unplanned += [self._faults.when("safety", cut, lambda: self.fall("no power")) for cut in POWER_CUTS]
            self._off()
        return identity

    async def close(self) -> None:
        """Drop the link; the output falls."""
        await super().close()
        while self._unplanned:
            self._unplanned.pop()()
        self._off()

    async def allow(self) -> None:
        """Set the output, or prove it. Raises SafetyOpen (no power), DeviceFault (it has fallen since it was set)."""
        now = await self._powered("allow")
        if self._fallen:
            raise DeviceFault(self._fallen, device=self.name)
        if not self._on and self._faults.active(self.name, "not_taken", now):
            raise DeviceFault("the output does not switch on", device=self.name)
        self._on = True
        self._plant.set_tools(enabled=True)

    async def read(self) -> EnableState:
        """As it is."""
        now = await self._answer("read")
        return EnableState(self._on, "" if self._on else self._fallen or "not asked for", now)

    async def halt(self) -> None:
        """Off."""
        await self._exchange("halt")
        self._off()

    async def safe(self) -> SafeState:
        """Safe while it is off."""
        await self._exchange("safe")
        return SafeState(not self._on, "the guns may turn" if self._on else "the guns may not turn")

    async def rearm(self) -> None:
        """Off: nothing turns on by itself."""
        await self._exchange("rearm")
        self._off()

    def fall(self, reason: str) -> None:
        """Off at once, whoever asked for it, until it is switched off and asked for again."""
        if self._on:
            self._off()
            self._fallen = reason

    def _off(self) -> None:
        self._on, self._fallen = False, ""
        if self._plant.tools_enabled:
            self._plant.set_tools(enabled=False)
