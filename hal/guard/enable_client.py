"""The output that lets the guns turn where a guard process owns it, `hal.interfaces.ToolEnable`."""

from __future__ import annotations

import asyncio

from hal.errors import NotConnected
from hal.guard.link import GuardLink
from hal.interfaces import EnableState, Identity, SafeState


class GuardedToolEnable:
    """The guard keeps it while all is well; from here it is switched off, and let on again by `rearm`."""

    def __init__(self, name: str, link: GuardLink) -> None:
        self.name = name
        self._link = link
        self._connected = False

    async def connect(self) -> Identity:
        """Reach the guard and have it prove the coupler. Raises as `hal.interfaces.Device.connect`."""
        if not self._connected:
            await self._link.reached()
            self._connected = True
        try:
            return Identity(**await self._link.call("connect", device=self.name))
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Let go of the guard, which goes on."""
        if self._connected:
            self._connected = False
            await self._link.release()

    async def read(self) -> EnableState:
        """What the guard told last. Raises NotConnected."""
        told = self._link.told
        if told is None:
            raise NotConnected("the guard is lost", device=self.name)
        return EnableState(not told.tools, told.tools, asyncio.get_running_loop().time())

    async def halt(self) -> None:
        """Off, read back by the guard."""
        self._require("halt")
        await self._link.call("halt", device=self.name)

    async def safe(self) -> SafeState:
        """Safe while the coupler says that the output is off."""
        self._require("safe")
        return SafeState(**await self._link.call("safe", device=self.name))

    async def rearm(self) -> None:
        """Off, then on again where nothing is in the way."""
        self._require("rearm")
        await self._link.call("rearm", device=self.name)

    def _require(self, command: str) -> None:
        if not self._connected:
            raise NotConnected(f"not connected ({command})", device=self.name)
