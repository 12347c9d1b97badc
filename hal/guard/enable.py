"""Lets the guns turn while the guard lives, is not tripped, and hears its controller; `hal.interfaces.ToolEnable`.

What the heartbeat is for the drives, this output is for the guns: it is asked for again and again, and falls by itself
where it no longer is. A trip takes it until the trip is cleared; what has been halted, or has fallen by itself, stays
off until it is re-armed.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from hal.errors import CellError, DeviceTimeout, NotConnected
from hal.guard.heartbeat import BEATS
from hal.interfaces import EnableOutput, EnableState, Identity, SafeState

STOPPED = "not re-armed"
RETRY_S = 0.1
"""After an exchange that went wrong."""


class EnableKeeper:
    """`output` is the bare output; `refused` says why the guns may not turn now, or nothing, and `look` that it has
    changed. An output with a watchdog of `watchdog_s` is fed by being asked for (0: it has none)."""

    def __init__(self, output: EnableOutput, refused: Callable[[], str], watchdog_s: float = 0.0) -> None:
        self.name = output.name
        self._output = output
        self._refused = refused
        self._watchdog_s = watchdog_s
        self._period_s = watchdog_s / BEATS or None
        self._set_s = 0.0
        self._stopped = STOPPED
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
        self._stop("closed")
        task.cancel()
        await asyncio.wait({task})
        with contextlib.suppress(CellError):
            await self._output.halt()
        await self._output.close()

    @property
    def reason(self) -> str:
        """Why the guns may not turn; empty while they may."""
        return self._stopped or self._refused()

    async def read(self) -> EnableState:
        """What it keeps to; nothing is asked of the coupler, which is asked all the time."""
        reason = self.reason
        return EnableState(not reason, reason, asyncio.get_running_loop().time())

    def look(self) -> None:
        """Something has changed: act on it, without waiting for anything."""
        if self._allowing is not None and self.reason:
            self._allowing.cancel()  # switching off does not wait behind it
        self._wake.set()

    async def halt(self) -> None:
        """Off until it is re-armed, read back."""
        self._stop("halted")
        async with self._acting:
            await self._output.halt()

    async def safe(self) -> SafeState:
        """Safe while the coupler says that the output is off."""
        return await self._output.safe()

    async def rearm(self) -> None:
        """Have it off, then let the guns turn again. Raises what keeps the output from being set."""
        async with self._acting:
            await self._output.rearm()
            self._stopped = ""
            if self._refused():
                return
            try:
                await self._allow()
            except BaseException:
                self._stopped = STOPPED
                raise
        self._wake.set()

    def _stop(self, reason: str) -> None:
        self._stopped = self._stopped or reason
        self.look()

    async def _allow(self) -> None:
        """Ask for the output, unless something changes meanwhile. Raises what the output raises."""
        self._allowing = asyncio.get_running_loop().create_task(self._output.allow(), name="tool enable asked for")
        try:
            await asyncio.wait({self._allowing})
        finally:
            asked, self._allowing = self._allowing, None
            asked.cancel()
        if not asked.cancelled():
            asked.result()
            self._set_s = asyncio.get_running_loop().time()

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
        """Have the output as it must be; returns when to look again (None: when told)."""
        try:
            if not self.reason:
                await self._allow()
                return self._period_s
            if not (await self._output.safe()).safe:
                await self._output.halt()
        except CellError as error:
            lost = isinstance(error, DeviceTimeout | NotConnected)
            silent_s = asyncio.get_running_loop().time() - self._set_s
            if not lost or silent_s >= self._watchdog_s:  # before that it may still be asked for in time
                self._stopped = self._stopped or error.reason
            return RETRY_S
        return None
