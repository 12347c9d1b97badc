"""Acting under rules: what is read before a motion begins and while it lasts, and how it is brought to rest.

A motion that breaks a rule on its way is stopped. One that is abandoned (its caller was cancelled) leaves the axis
standing.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, TypeVar

from hal.errors import CellError, DeviceError, DeviceFault, DeviceRefused, SafetyOpen
from hal.interfaces import Axis, CameraPark, Chuck, Device, ForceGuard, SafetyInputs, ToolEnable
from hal.latch import Latch
from hal.permits import NEEDED, AxisName, PermitLimits, Readings, Target, camera_refusal, motion_refusal, safety_refusal

T = TypeVar("T")
WATCH_S = 0.2
"""Between two looks at the rules while an axis moves; the hard-wired circuit is the fast one."""
HALT_DEADLINE_S = 0.3
GRACE_S = 0.02
"""A halted command has so long to return."""


class Permits:
    """The rules of one cell with the devices that they look at."""

    def __init__(
        self,
        axes: Mapping[AxisName, Axis],
        chuck: Chuck,
        camera_park: CameraPark,
        safety: SafetyInputs,
        tool_enable: ToolEnable,
        guard: ForceGuard,
        limits: PermitLimits,
        latch: Latch,
    ) -> None:
        self._axes = axes
        self._chuck = chuck
        self._camera_park = camera_park
        self._safety = safety
        self._tool_enable = tool_enable
        self._guard = guard
        self._limits = limits
        self.latch = latch

    async def motion(self, axis: AxisName, target: Target) -> CellError | None:
        """The error that a motion of `axis` to `target` meets now, or None."""
        readings = await self._read(axis, self._axes[axis])
        return _error(axis, readings, motion_refusal(axis, target, readings, self._limits))

    async def camera(self, target: str) -> CellError | None:
        """The error that a swing of the camera arm to `target` meets now, or None."""
        readings = await self._read("camera_park", None)
        return _error("camera_park", readings, camera_refusal(target, readings, self._limits))

    async def power(self, device: str) -> CellError | None:
        """The error that powering `device` meets now, or None."""
        readings = await self._read("", None)
        return _error(device, readings, safety_refusal(readings.safety))

    async def tools(self, gun: str) -> CellError | None:
        """The error that turning `gun` meets now, or None."""
        if refused := await self.power(gun):
            return refused
        state = await _in_time(self._tool_enable.read, self._limits.read_s)
        if state is not None and state.enabled:
            return None
        reason = state.reason if state is not None else "unknown"
        return DeviceFault(f"the tool enable is off: {reason}", device=gun)

    async def _read(self, name: str, moving: Axis | None) -> Readings:
        asked: dict[str, Callable[[], Awaitable[Any]]] = {} if moving is None else {"axis": moving.read}
        for device in NEEDED.get(name, ("safety",)):
            match device:
                case "safety":
                    asked["safety"] = self._safety.read
                case "chuck":
                    asked["chuck"] = self._chuck.read
                case "camera_park":
                    asked["camera"] = self._camera_park.read
                case "jack" | "gun_feed" | "gun_table":
                    asked[device] = self._axes[device].read
        return Readings(**await _answers(asked, self._limits.read_s), guarded=self._guard.state().armed)


async def _answers(asked: Mapping[str, Callable[[], Awaitable[Any]]], within_s: float) -> dict[str, Any]:
    """What each gives, one after the other within `within_s` in all; None for one that fails or is late.

    Behind one that uses up the time the others are asked at once, with as much time again: none is unknown because of
    another.
    """
    answers: dict[str, Any] = {}
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(within_s):
            for name, read in asked.items():
                answers[name] = None
                with contextlib.suppress(DeviceError):
                    answers[name] = await read()
    left = [name for name in asked if name not in answers]
    found = await asyncio.gather(*(_in_time(asked[name], within_s) for name in left))
    return answers | dict(zip(left, found, strict=True))


async def _in_time(read: Callable[[], Awaitable[Any]], within_s: float) -> Any:
    with contextlib.suppress(DeviceError, TimeoutError):
        async with asyncio.timeout(within_s):
            return await read()
    return None


def _error(device: str, readings: Readings, reason: str | None) -> CellError | None:
    if reason is None:
        return None
    if readings.safety is None or not readings.safety.ok:
        return SafetyOpen(reason, device=device)
    return DeviceRefused(reason, device=device)


async def perform(
    device: Device,
    latch: Latch,
    judge: Callable[[], Awaitable[CellError | None]],
    command: Callable[[], Coroutine[Any, Any, T]],
) -> T:
    """Run `command` of `device` while latch and `judge` let it; it never goes on without its caller.

    Raises what `judge` says, GuardTripped, SafetyOpen, Interrupted, and whatever the command raises.
    """
    if refused := latch.refusal(device.name) or await judge():
        raise refused
    task = latch.start(device.name, command)
    try:
        while not task.done():
            await asyncio.wait({task}, timeout=WATCH_S)
            if not task.done() and (refused := await judge()) and not task.done():
                raise refused
    finally:
        if not task.done():
            await _stop(device, task)
    if not task.cancelled() and task.exception() is not None and isinstance(refused := await judge(), SafetyOpen):
        raise refused from task.exception()  # the hard-wired circuit took the power: that is the cause
    return latch.result(device.name, task)


async def _stop(device: Device, task: asyncio.Task[Any]) -> None:
    """Bring `device` to rest and `task` to its end, whatever else happens to the caller meanwhile; bounded in time."""
    stopping = asyncio.create_task(_halt_and_end(device, task), name=f"{device.name} stop")
    cancelled = False
    while not stopping.done():
        try:
            await asyncio.wait({stopping})
        except asyncio.CancelledError:
            cancelled = True
    if cancelled:
        raise asyncio.CancelledError


async def _halt_and_end(device: Device, task: asyncio.Task[Any]) -> None:
    """Halt; where the command does not end by that, withdraw it and halt once more."""
    for _ in range(2):
        with contextlib.suppress(DeviceError, TimeoutError):
            async with asyncio.timeout(HALT_DEADLINE_S):
                await device.halt()
        await asyncio.wait({task}, timeout=GRACE_S)
        if task.done():
            return
        task.cancel()
