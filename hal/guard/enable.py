"""Lets the guns turn while the guard lives, is not tripped, and hears its controller; `hal.interfaces.ToolEnable`.

What the heartbeat is for the drives, this output is for the guns: it is asked for again and again, and falls by itself
where it no longer is. Once it has fallen it stays off until the cell is re-armed.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from hal.errors import CellError, DeviceTimeout
from hal.guard.heartbeat import BEATS
from hal.interfaces import EnableOutput, EnableState, Identity, SafeState

STOPPED = "not re-armed"
RETRY_S = 0.1
"""After an exchange that went wrong."""


class EnableKeeper:
    """`output` is the bare output; `refused` says why the guns may not turn, or nothing. An output with a watchdog of
    `watchdog_s` is fed by being asked for (0: it has none)."""

    def __init__(self, output: EnableOutput, refused: Callable[[], str], watchdog_s: float = 0.0) -> None:
        self.name = output.name
        self._output = output
        self._refused = refused
        self._period_s = watchdog_s / BEATS or None
        self._off_reason = STOPPED
        self._wake = asyncio.Event()
        self._acting = asyncio.Lock()
        self._allowing: asyncio.Task[None] | None = None
        self._task: asyncio.Task[None] | None = None

    async def connect(self) -> Identity:
        """Prove the coupler's identity. Raises as `hal.interfaces.Device.connect`."""
        identity = await self._output.connect()
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._keep(), name="tool enable")
        return identity

    async def close(self) -> None:
        """Off, as far as it can be said; no task is left."""
        task, self._task = self._task, None
        if task is None:
            return
        self.fall("closed")
        task.cancel()
        await asyncio.wait({task})
        with contextlib.suppress(CellError):
            await self._output.halt()
        await self._output.close()

    def fall(self, reason: str) -> None:
        """The guns must not turn from here on, until `rearm`. Never waits; the first reason stays."""
        self._off_reason = self._off_reason or reason
        if self._allowing is not None:
            self._allowing.cancel()  # switching off does not wait behind it
        self._wake.set()

    def state(self) -> EnableState:
        """What it keeps to."""
        return EnableState(not self._off_reason, self._off_reason, asyncio.get_running_loop().time())

    async def read(self) -> EnableState:
        """As `state`: nothing is asked of the coupler, which is asked all the time."""
        return self.state()

    async def halt(self) -> None:
        """Off, read back."""
        self.fall("halted")
        async with self._acting:
            await self._output.halt()

    async def safe(self) -> SafeState:
        """Safe while the coupler says that the output is off."""
        return await self._output.safe()

    async def rearm(self) -> None:
        """Have it off, then let the guns turn again. Raises what keeps the output from being set."""
        async with self._acting:
            await self._output.rearm()
            if refused := self._refused():
                self._off_reason = refused
                return
            self._off_reason = ""
            try:
                await self._allow()
            except BaseException:
                self._off_reason = STOPPED
                raise
        self._wake.set()

    async def _allow(self) -> None:
        """Ask for the output, unless it falls meanwhile. Raises what the output raises."""
        self._allowing = asyncio.get_running_loop().create_task(self._output.allow(), name="tool enable asked for")
        try:
            await asyncio.wait({self._allowing})
        finally:
            asked, self._allowing = self._allowing, None
            asked.cancel()
        if not asked.cancelled():
            asked.result()

    async def _keep(self) -> None:
        again_s: float | None = None
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(again_s):
                    await self._wake.wait()
            self._wake.clear()
            async with self._acting:
                again_s = await self._act()

    async def _act(self) -> float | None:
        """Have the output as it must be; returns when to look again (None: when woken)."""
        if not self._off_reason:
            self._off_reason = self._refused()
        try:
            if not self._off_reason:
                await self._allow()
                return 0.0 if self._off_reason else self._period_s
            if not (await self._output.safe()).safe:
                await self._output.halt()
        except DeviceTimeout:
            return RETRY_S  # asked again in time, or it falls by itself
        except CellError as error:
            self._off_reason = self._off_reason or error.reason
            return RETRY_S
        return None
