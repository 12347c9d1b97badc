"""Devices that act, behind the latch and the motion rules: the same Protocols, by composition.

The motion rules are checked before a motion begins and again while it lasts. A motion command that is abandoned
(its caller was cancelled) leaves the axis standing.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, Generic, Literal, TypeVar

from hal.errors import CellError, DeviceError, DeviceFault, DeviceRefused, SafetyOpen
from hal.interfaces import (
    Axis,
    AxisLimits,
    AxisState,
    CameraPark,
    Chuck,
    ChuckState,
    Device,
    ForceGuard,
    Gun,
    Heater,
    HeaterState,
    Identity,
    NutFeeder,
    ParkState,
    SafeState,
    SafetyInputs,
    TighteningProgram,
    TighteningResult,
    TurnResult,
)
from hal.latch import Latch
from hal.permits import NEEDED, AxisName, PermitLimits, Readings, Target, camera_refusal, motion_refusal, safety_refusal

T = TypeVar("T")
D = TypeVar("D", bound=Device)
WATCH_S = 0.2
"""Between two looks at the rules while an axis moves; the hard-wired circuit is the fast one."""
HALT_DEADLINE_S = 0.3
GRACE_S = 0.02
"""A halted command has so long to return."""
READ_DEADLINE_S = 0.25
"""A device that has not answered by then is unknown."""


class Permits:
    """The rules of one cell with the devices that they look at."""

    def __init__(
        self,
        axes: Mapping[AxisName, Axis],
        chuck: Chuck,
        camera_park: CameraPark,
        safety: SafetyInputs,
        guard: ForceGuard,
        limits: PermitLimits,
        latch: Latch,
    ) -> None:
        self._axes = axes
        self._chuck = chuck
        self._camera_park = camera_park
        self._safety = safety
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

    async def _read(self, name: str, moving: Axis | None) -> Readings:
        needed, axes = NEEDED.get(name, ("safety",)), self._axes
        deadline = asyncio.get_running_loop().time() + READ_DEADLINE_S
        return Readings(
            axis=await _or_none(moving.read(), deadline) if moving is not None else None,
            safety=await _or_none(self._safety.read(), deadline),
            chuck=await _or_none(self._chuck.read(), deadline) if "chuck" in needed else None,
            camera=await _or_none(self._camera_park.read(), deadline) if "camera_park" in needed else None,
            jack=await _or_none(axes["jack"].read(), deadline) if "jack" in needed else None,
            gun_feed=await _or_none(axes["gun_feed"].read(), deadline) if "gun_feed" in needed else None,
            gun_table=await _or_none(axes["gun_table"].read(), deadline) if "gun_table" in needed else None,
            guarded=self._guard.state().armed,
        )


async def _or_none(read: Awaitable[T], deadline: float) -> T | None:
    try:
        async with asyncio.timeout_at(deadline):
            return await read
    except (DeviceError, TimeoutError):
        return None


def _error(device: str, readings: Readings, reason: str | None) -> CellError | None:
    if reason is None:
        return None
    if readings.safety is None or not readings.safety.ok:
        return SafetyOpen(reason, device=device)
    return DeviceRefused(reason, device=device)


async def _perform(
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


class _Delegate(Generic[D]):
    """The five things that every device can do, passed on as they are."""

    def __init__(self, inner: D, permits: Permits) -> None:
        self._inner = inner
        self._permits = permits
        self.name = inner.name

    async def connect(self) -> Identity:
        return await self._inner.connect()

    async def close(self) -> None:
        await self._inner.close()

    async def halt(self) -> None:
        await self._inner.halt()

    async def safe(self) -> SafeState:
        return await self._inner.safe()

    async def rearm(self) -> None:
        await self._inner.rearm()

    async def _powered(self, command: Callable[[], Coroutine[Any, Any, T]]) -> T:
        return await _perform(self._inner, self._permits.latch, lambda: self._permits.power(self.name), command)


class PermittedAxis(_Delegate[Axis]):
    """An axis that moves only while latch and motion rules let it, and has arrived only where its encoder says so."""

    def __init__(self, axis: AxisName, inner: Axis, permits: Permits, in_position: float) -> None:
        super().__init__(inner, permits)
        self._axis = axis
        self._in_position = in_position

    @property
    def unit(self) -> Literal["mm", "deg"]:
        return self._inner.unit

    @property
    def limits(self) -> AxisLimits:
        return self._inner.limits

    async def read(self) -> AxisState:
        return await self._inner.read()

    async def home(self) -> AxisState:
        return await self._motion("home", lambda: self._inner.home())

    async def move_to(self, position: float, *, speed: float) -> AxisState:
        state = await self._motion(position, lambda: self._inner.move_to(position, speed=speed))
        if not abs(state.position - position) <= self._in_position:
            reason = f"reports {position:g} {self.unit} reached, its encoder reads {state.position:g} {self.unit}"
            raise DeviceFault(reason, device=self.name)
        return state

    async def _motion(self, target: Target, command: Callable[[], Coroutine[Any, Any, AxisState]]) -> AxisState:
        permits = self._permits
        return await _perform(self._inner, permits.latch, lambda: permits.motion(self._axis, target), command)


class PermittedCameraPark(_Delegate[CameraPark]):
    """A camera arm that swings only while nothing stands in its way."""

    async def read(self) -> ParkState:
        return await self._inner.read()

    async def go(self, position: Literal["parked", "rotor", "shaft"]) -> ParkState:
        permits = self._permits
        judge: Callable[[], Awaitable[CellError | None]] = lambda: permits.camera(position)  # noqa: E731
        return await _perform(self._inner, permits.latch, judge, lambda: self._inner.go(position))


class PermittedGun(_Delegate[Gun]):
    """A gun that turns only while the latch is open and the safety inputs are closed."""

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        return await self._powered(
            lambda: self._inner.turn(angle_deg, speed_rpm=speed_rpm, torque_limit_nm=torque_limit_nm)
        )

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        return await self._powered(lambda: self._inner.tighten(key, program))

    async def result(self, key: str) -> TighteningResult | None:
        return await self._inner.result(key)


class PermittedHeater(_Delegate[Heater]):
    """A heater that heats only while the latch is open and the safety inputs are closed; off is always let through."""

    @property
    def max_power_w(self) -> float:
        return self._inner.max_power_w

    async def read(self) -> HeaterState:
        """As the inner one; an alarm whose cause is the open safety circuit is raised as SafetyOpen."""
        state = await self._inner.read()
        if state.alarm and (refused := await self._permits.power(self.name)):
            raise refused
        return state

    async def heat(self, setpoint_c: float, *, ramp_k_per_min: float, max_power_w: float) -> HeaterState:
        return await self._powered(
            lambda: self._inner.heat(setpoint_c, ramp_k_per_min=ramp_k_per_min, max_power_w=max_power_w)
        )

    async def off(self) -> HeaterState:
        return await self._inner.off()


class PermittedChuck(_Delegate[Chuck]):
    """A chuck whose jaws move only while the latch is open and the safety inputs are closed."""

    async def read(self) -> ChuckState:
        return await self._inner.read()

    async def clamp(self) -> ChuckState:
        return await self._powered(lambda: self._inner.clamp())

    async def release(self) -> ChuckState:
        return await self._powered(lambda: self._inner.release())


class PermittedNutFeeder(_Delegate[NutFeeder]):
    """A feeder that loads only while the latch is open and the safety inputs are closed."""

    async def count(self) -> int:
        return await self._inner.count()

    async def load(self, gun: Literal["a", "b"]) -> bool:
        return await self._powered(lambda: self._inner.load(gun))
