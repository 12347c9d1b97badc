"""Fake axes: a drive in profile position mode on the plant's motion, `hal.interfaces.Axis`.

What survives a crash of the controller (homed, power, brake, motion) lives in the plant; here is only the link to it.
The drive ramps within `RAMP_S` at least, so that starting and stopping in creep does not look like a contact force,
and stops four times as hard as it ramps. A motion that was halted leaves the drive in quick stop until `rearm`.
"""

from __future__ import annotations

import asyncio
import math
from typing import Literal

from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted, NotConnected, SafetyOpen
from hal.fake.faults import FaultBook
from hal.fake.motion import CLOCK_S, AxisMotion
from hal.fake.plant import Plant
from hal.interfaces import AxisLimits, AxisState, Identity, SafeState

RAMP_S = 0.1
QUICK_STOP_FACTOR = 4.0
HOMING_SHARE = 0.5
"""Of the largest speed."""
HOMING_S = 1.0
"""To find the reference switch once there."""


class FakeAxis:
    """One axis of the plant. Positions are what the encoder reads, in `unit`."""

    def __init__(
        self, name: str, unit: Literal["mm", "deg"], limits: AxisLimits, plant: Plant, faults: FaultBook
    ) -> None:
        self._name = name
        self._unit: Literal["mm", "deg"] = unit
        self._limits = limits
        self._plant = plant
        self._faults = faults
        self._connected = False
        self._commanded = False
        self._halts = 0
        self._fault = ""

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    @property
    def unit(self) -> Literal["mm", "deg"]:
        """Of positions; speeds are per second."""
        return self._unit

    @property
    def limits(self) -> AxisLimits:
        """Travel, speed, acceleration."""
        return self._limits

    async def connect(self) -> Identity:
        """Prove the drive's identity."""
        await self._faults.gate(self._name, "connect")
        self._connected = True
        return Identity("cellctl", "servo axis", f"{self._name}-1", "1.0", simulated=True)

    async def close(self) -> None:
        """Drop the link: a drive that loses its controller stops by itself."""
        if self._connected and self._motion.moving(now := asyncio.get_running_loop().time()):
            self._quick_stop(now)
        self._connected = False

    # ------------------------------------------------------------ reading

    async def read(self) -> AxisState:
        """Encoder and the drive's flags."""
        return self._state(await self._exchange("read"))

    async def safe(self) -> SafeState:
        """Safe while the axis stands."""
        now = await self._exchange("safe")
        if self._motion.moving(now):
            return SafeState(False, f"{self._name} is moving")
        braked = now >= self._motion.brake_closes_s
        return SafeState(
            True,
            f"{self._name} stands at {self._motion.position(now):.3f} {self._unit}, "
            f"{'brake closed' if braked else 'held by the drive'}",
        )

    # ------------------------------------------------------------ commands

    async def halt(self) -> None:
        """Quick stop; returns once the axis stands. A standing axis only acknowledges."""
        await self._exchange("halt")
        self._halts += self._commanded
        if self._motion.moving(asyncio.get_running_loop().time()):
            await asyncio.sleep(self._plant.numbers.properties.drive_delay_s)
        now = asyncio.get_running_loop().time()
        if self._motion.moving(now):
            self._fault = self._fault or "in quick stop"
            end_s = self._quick_stop(now)
            await asyncio.sleep(max(end_s - asyncio.get_running_loop().time(), 0.0))

    async def rearm(self) -> None:
        """Out of quick stop or fault: the set-point is where the axis stands."""
        now = await self._exchange("rearm")
        if self._motion.moving(now):
            raise DeviceRefused("is moving", device=self._name)
        if self._faults.power_cut(now):
            return
        self._fault = ""
        self._motion.enabled = True

    async def home(self) -> AxisState:
        """Drive to the reference switch at 0 and take it for zero. Raises as `move_to` does."""
        now = await self._powered("home")
        speed = HOMING_SHARE * self._limits.max_speed
        target = min(max(0.0, self._limits.low), self._limits.high)
        await self._run(target, speed, now)
        await asyncio.sleep(HOMING_S)
        now = await self._powered("home")
        self._motion.homed = self._faults.active(self._name, "home_lost", now) is None
        return self._state(now)

    async def move_to(self, position: float, *, speed: float) -> AxisState:
        """See `hal.interfaces.Axis.move_to`. An axis that is on its way refuses a second command."""
        now = await self._powered("move_to")
        if not self._homed(now):
            raise DeviceRefused("is not homed", device=self._name)
        if not self._limits.low <= position <= self._limits.high:
            raise DeviceRefused(
                f"{position:g} {self._unit} is outside {self._limits.low:g} to {self._limits.high:g}", device=self._name
            )
        if not (math.isfinite(speed) and speed > 0.0):
            raise DeviceRefused(f"speed {speed:g} {self._unit}/s is not positive", device=self._name)
        if self._faults.active(self._name, "stale_target", now):
            return self._state(now)
        await self._run(position, min(speed, self._limits.max_speed), now)
        return self._state(await self._exchange("move_to"))

    async def _run(self, target: float, speed: float, now: float) -> None:
        """Start a profile and stay until it ends, is halted, or the drive trips."""
        acceleration = min(self._limits.max_acceleration, speed / RAMP_S)
        halts = self._halts
        changed = asyncio.Event()
        unsubscribe = self._plant.subscribe(changed.set)
        self._commanded = True
        try:
            trajectory = self._plant.start_move(self._name, target, speed=speed, acceleration=acceleration, now=now)
            while (now := asyncio.get_running_loop().time()) < trajectory.end_s - CLOCK_S:
                changed.clear()
                self._trip(now)
                if self._halts != halts or self._motion.now_at is not trajectory:
                    raise Interrupted("halted on the way", device=self._name)
                edge = min(self._faults.next_change(self._name, now), self._faults.next_change("safety", now))
                try:
                    async with asyncio.timeout_at(min(trajectory.end_s, edge)):
                        await changed.wait()
                except TimeoutError:
                    continue
            if self._motion.now_at is not trajectory:
                raise Interrupted("halted on the way", device=self._name)
            self._plant.advance(now)
        except asyncio.CancelledError:
            self._quick_stop(asyncio.get_running_loop().time())
            raise
        finally:
            self._commanded = False
            unsubscribe()

    # ------------------------------------------------------------ inside

    @property
    def _motion(self) -> AxisMotion:
        return self._plant.motion[self._name]

    async def _exchange(self, command: str) -> float:
        """One request and its answer: the loop time, with the plant advanced to it."""
        if not self._connected:
            raise NotConnected(f"not connected ({command})", device=self._name)
        await self._faults.gate(self._name, command)
        now = asyncio.get_running_loop().time()
        self._plant.advance(now)
        self._look(now)
        return now

    async def _powered(self, command: str) -> float:
        """As `_exchange`, for what moves. Raises SafetyOpen, DeviceFault, DeviceRefused."""
        now = await self._exchange(command)
        if cut := self._faults.power_cut(now):
            raise SafetyOpen(f"no power ({cut})", device=self._name)
        if self._fault == "following error":
            raise DeviceFault(self._fault, device=self._name)
        if self._fault or not self._motion.enabled:
            raise DeviceRefused(f"{self._fault or 'not enabled'}: re-arm first", device=self._name)
        if self._commanded or self._motion.moving(now):
            raise DeviceRefused("is on its way already", device=self._name)
        return now

    def _look(self, now: float) -> None:
        """The drive acts on its own faults whether anybody waits for it or not."""
        if self._faults.active(self._name, "home_lost", now):
            self._motion.homed = False
        if self._faults.power_cut(now) and self._motion.enabled:
            self._motion.enabled = False
            self._fault = "power was cut"
            self._plant.cut_power(self._name, self._deceleration, now)

    def _trip(self, now: float) -> None:
        """Stop in motion for a fault of the drive, a lost supply or a lost heartbeat, and raise accordingly."""
        self._look(now)
        if self._fault == "power was cut":
            raise SafetyOpen(f"stopped, no power ({self._faults.power_cut(now)})", device=self._name)
        for kind, error in (("gone", NotConnected), ("hung", DeviceTimeout)):
            if self._faults.active(self._name, kind, now):
                self._fault = "in quick stop"
                self._quick_stop(now)
                raise error("the link was lost in motion", device=self._name)
        if self._faults.active(self._name, "following_error", now):
            self._fault = "following error"
            self._quick_stop(now)
            raise DeviceFault(self._fault, device=self._name)

    @property
    def _deceleration(self) -> float:
        return QUICK_STOP_FACTOR * self._limits.max_acceleration

    def _quick_stop(self, now: float) -> float:
        return self._plant.stop(self._name, self._deceleration, now).end_s

    def _homed(self, now: float) -> bool:
        return self._motion.homed and self._faults.active(self._name, "home_lost", now) is None

    def _state(self, now: float) -> AxisState:
        motion = self._motion
        return AxisState(
            position=motion.position(now),
            velocity=motion.velocity(now),
            homed=self._homed(now),
            enabled=motion.enabled,
            brake_closed=now >= motion.brake_closes_s,
            moving=motion.moving(now),
            time_s=now,
        )
