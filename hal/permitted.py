"""Devices that act, behind the latch and the motion rules: the same Protocols, by composition. See hal.interlocks."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Generic, Literal, TypeVar

from hal.errors import CellError, DeviceFault
from hal.interfaces import (
    Axis,
    AxisLimits,
    AxisState,
    CameraPark,
    Chuck,
    ChuckState,
    Device,
    Gun,
    Heater,
    HeaterState,
    Identity,
    NutFeeder,
    ParkState,
    SafeState,
    TighteningProgram,
    TighteningResult,
    TurnResult,
)
from hal.interlocks import Permits, perform
from hal.permits import AxisName, Target

T = TypeVar("T")
D = TypeVar("D", bound=Device)


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

    async def _under(
        self, judge: Callable[[], Awaitable[CellError | None]], command: Callable[[], Coroutine[Any, Any, T]]
    ) -> T:
        return await perform(self._inner, self._permits.latch, judge, command)

    async def _powered(self, command: Callable[[], Coroutine[Any, Any, T]]) -> T:
        return await self._under(lambda: self._permits.power(self.name), command)


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

    async def refusal(self, target: Target) -> CellError | None:
        """The error that a motion to `target` (in `unit`, or "home") meets now; None where it may begin."""
        return self._permits.latch.refusal(self.name) or await self._permits.motion(self._axis, target)

    async def home(self) -> AxisState:
        return await self._motion("home", lambda: self._inner.home())

    async def move_to(self, position: float, *, speed: float) -> AxisState:
        state = await self._motion(position, lambda: self._inner.move_to(position, speed=speed))
        if not abs(state.position - position) <= self._in_position:
            reason = f"reports {position:g} {self.unit} reached, its encoder reads {state.position:g} {self.unit}"
            raise DeviceFault(reason, device=self.name)
        return state

    async def _motion(self, target: Target, command: Callable[[], Coroutine[Any, Any, AxisState]]) -> AxisState:
        return await self._under(lambda: self._permits.motion(self._axis, target), command)


class PermittedCameraPark(_Delegate[CameraPark]):
    """A camera arm that swings only while nothing stands in its way."""

    async def read(self) -> ParkState:
        return await self._inner.read()

    async def go(self, position: Literal["parked", "rotor", "shaft"]) -> ParkState:
        return await self._under(lambda: self._permits.camera(position), lambda: self._inner.go(position))


class PermittedGun(_Delegate[Gun]):
    """A gun that turns only while the latch is open, the safety inputs are closed and the tool enable is on."""

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        return await self._enabled(
            lambda: self._inner.turn(angle_deg, speed_rpm=speed_rpm, torque_limit_nm=torque_limit_nm)
        )

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        return await self._enabled(lambda: self._inner.tighten(key, program))

    async def result(self, key: str) -> TighteningResult | None:
        return await self._inner.result(key)

    async def _enabled(self, command: Callable[[], Coroutine[Any, Any, T]]) -> T:
        return await self._under(lambda: self._permits.tools(self.name), command)


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
