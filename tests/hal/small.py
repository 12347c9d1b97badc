"""Small devices for tests of guard, permits and cell: what the Protocols ask, and switches to make them fail."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hal.errors import DeviceFault, DeviceRefused, Interrupted
from hal.interfaces import (
    AxisLimits,
    AxisState,
    ChuckState,
    EnableState,
    ForceBlock,
    Identity,
    ParkState,
    SafeState,
    SafetyState,
)

GOOD_SAFETY = SafetyState(True, True, True, True, False, 0.0)


class SmallDevice:
    """Everything a device must do; `hang` makes every exchange wait for ever, `error` makes it raise."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.hang = False
        self.error: Exception | None = None
        self.halts = 0
        self.rearms = 0
        self.closed = False

    async def exchange(self) -> None:
        if self.error is not None:
            raise self.error
        if self.hang:
            await asyncio.sleep(1e6)

    async def connect(self) -> Identity:
        await self.exchange()
        return Identity("tests", "small", self.name, "1", True)

    async def close(self) -> None:
        self.closed = True

    async def halt(self) -> None:
        self.halts += 1
        await self.exchange()

    async def safe(self) -> SafeState:
        await self.exchange()
        return SafeState(True, "at rest")

    async def rearm(self) -> None:
        await self.exchange()
        self.rearms += 1


class SmallAxis(SmallDevice):
    """Moves at the asked speed; `delay_s` passes between a command and the start of its motion."""

    unit: Literal["mm", "deg"] = "mm"
    limits = AxisLimits(-500.0, 500.0, 100.0, 100.0)

    def __init__(self, name: str, position: float = 0.0) -> None:
        super().__init__(name)
        self.state = AxisState(position, 0.0, True, True, True, False, 0.0)
        self.delay_s = 0.0
        self.starts = 0
        self._stop = asyncio.Event()

    @property
    def moving(self) -> bool:
        return self.state.moving

    async def read(self) -> AxisState:
        await self.exchange()
        return self.state

    async def home(self) -> AxisState:
        self.state = replace(self.state, homed=True)
        return await self.move_to(0.0, speed=10.0)

    async def move_to(self, position: float, *, speed: float) -> AxisState:
        if not math.isfinite(position):
            raise DeviceRefused("target is no number", device=self.name)
        await asyncio.sleep(self.delay_s)
        await self.exchange()
        self.starts += 1
        self._stop = asyncio.Event()
        self.state = replace(self.state, moving=True)
        try:
            await asyncio.wait_for(self._stop.wait(), abs(position - self.state.position) / speed)
        except TimeoutError:
            self.state = replace(self.state, moving=False, position=position)
            return self.state
        raise Interrupted("halted", device=self.name)

    async def halt(self) -> None:
        await super().halt()
        self.state = replace(self.state, moving=False)
        self._stop.set()

    async def safe(self) -> SafeState:
        await self.exchange()
        return SafeState(not self.state.moving, "moving" if self.state.moving else "stands")


class SmallToolEnable(SmallDevice):
    """An output as `hal.interfaces.EnableOutput` wants it; `enabled` and `fallen` are its switches."""

    def __init__(self, *, enabled: bool = True) -> None:
        super().__init__("tool_enable")
        self.enabled = enabled
        self.fallen = ""
        self.asked = 0

    async def allow(self) -> None:
        self.asked += 1
        await self.exchange()
        if self.fallen:
            raise DeviceFault(self.fallen, device=self.name)
        self.enabled = True

    async def read(self) -> EnableState:
        await self.exchange()
        return EnableState(self.enabled, "" if self.enabled else "off", 0.0)

    async def halt(self) -> None:
        await super().halt()
        self.enabled, self.fallen = False, ""

    async def rearm(self) -> None:
        await super().rearm()
        self.enabled, self.fallen = False, ""

    async def safe(self) -> SafeState:
        await self.exchange()
        return SafeState(not self.enabled, "on" if self.enabled else "off")


class SmallForce(SmallDevice):
    """1 kHz of `raw_n`; `script` replaces the value at given sample numbers; `silent` stops the stream."""

    rate_hz = 1000.0
    range_n = 2000.0

    def __init__(self, raw_n: float = 1000.0) -> None:
        super().__init__("jack_force")
        self.raw_n = raw_n
        self.script: dict[int, float] = {}
        self.silent = False
        self.frozen = False
        self.skip = 0
        self.late_s = 0.0
        self.kept = 0
        self.readers = 0
        self.sequence = 0

    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        self.readers += 1
        assert self.readers == 1, "two readers"
        try:
            await self.exchange()
            if self.silent:
                await asyncio.sleep(1e6)
            start = asyncio.get_running_loop().time()
            first, self.skip = self.sequence + self.skip, 0
            values = np.array(
                [
                    self.script.get(first + i, self.raw_n + (0.0 if self.frozen else 1e-3 * ((first + i) % 2)))
                    for i in range(count)
                ]
            )
            out = ~((values >= low_n) & (values <= high_n))
            taken = int(np.argmax(out)) + 1 if out.any() else count
            if self.kept > 0:  # what the link had kept comes at once
                taken, age_s = min(taken, self.kept), self.kept * 0.001
                self.kept -= taken
                self.sequence = first + taken
                return ForceBlock(first, start - age_s, 0.001, values[:taken])
            await asyncio.sleep(taken / self.rate_hz)
            self.sequence = first + taken
            return ForceBlock(first, start - self.late_s + 0.001, 0.001, values[:taken])
        finally:
            self.readers -= 1


class SmallSafety(SmallDevice):
    """Safety inputs with a state to be set."""

    def __init__(self) -> None:
        super().__init__("safety")
        self.state = GOOD_SAFETY

    async def read(self) -> SafetyState:
        await self.exchange()
        return self.state


class SmallChuck(SmallDevice):
    """A chuck that is clamped."""

    def __init__(self) -> None:
        super().__init__("chuck")
        self.state = ChuckState(True, True, 6.0, 0.0)

    async def read(self) -> ChuckState:
        await self.exchange()
        return self.state

    async def clamp(self) -> ChuckState:
        await self.exchange()
        return self.state

    async def release(self) -> ChuckState:
        await self.exchange()
        return self.state


class SmallPark(SmallDevice):
    """A camera arm that takes one second."""

    def __init__(self) -> None:
        super().__init__("camera_park")
        self.state = ParkState("parked", 0.0)

    async def read(self) -> ParkState:
        await self.exchange()
        return self.state

    async def go(self, position: Literal["parked", "rotor", "shaft"]) -> ParkState:
        self.state = ParkState(None, 0.0)
        await asyncio.sleep(1.0)
        self.state = ParkState(position, 0.0)
        return self.state


@dataclass
class SmallGuardState:
    """Only what the permits look at."""

    armed: bool = True
