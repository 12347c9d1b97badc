"""Fake guns: links to the tightening controllers of the plant. `hal.fake.joints.gun_bench`: where sockets meet nuts."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from hal.errors import ConfigError, DeviceFault, DeviceRefused, Interrupted, SafetyOpen, UnknownOutcome
from hal.fake.devices.io import IoDevice, Stroke
from hal.fake.faults import FaultBook
from hal.fake.joints.gun_memory import GunMemory, GunName
from hal.fake.joints.nuts import Error
from hal.fake.joints.state import Joints
from hal.fake.plant import Plant
from hal.interfaces import SafeState, TighteningProgram, TighteningResult, TurnResult

PLANTED: tuple[Error, ...] = ("cross_thread", "slip_off", "missing_washer", "stripped_thread", "yielded_stud")
FEIGNED_S = 2.0
"""A controller whose transducer lies is done after this."""


class FakeGun(IoDevice):
    """Implements `hal.interfaces.Gun`. A program goes on to its end when nobody waits for it any more."""

    model = "tightening controller"

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        """`name` is gun_a or gun_b. Raises ConfigError for another one."""
        super().__init__(name, plant, faults)
        if name not in ("gun_a", "gun_b"):
            raise ConfigError("guns are gun_a and gun_b", place=f"devices.{name}")
        self._gun: GunName = "a" if name == "gun_a" else "b"
        self._stroke = Stroke()
        plant.on_tools(self._enable_changed)

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        """Turn slowly. Raises DeviceRefused (disabled, busy, no speed), Interrupted (halted on the way), SafetyOpen,
        DeviceFault (the tool enable went off)."""
        now = await self._ready("turn", speed_rpm)
        joints = joints_of(self._plant)
        self._plant_errors(joints, now)
        plan = joints.plan_turn(self._gun, angle_deg, torque_limit_nm, now)
        seconds = abs(plan.spindle_deg) / (6.0 * speed_rpm) + joints.gun.idle_s
        try:
            await self._run_for(seconds)
        except BaseException:
            reached = self._now() - now
            share = min(max(reached / seconds, 0.0), 1.0)
            joints.apply(self._gun, joints.plan_turn(self._gun, plan.spindle_deg * share, torque_limit_nm, now), now)
            raise
        end = self._now()
        joints.apply(self._gun, plan, end)
        return TurnResult(plan.spindle_deg, plan.peak_nm, end)

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        """Run `program` once under `key`.

        Raises DeviceRefused (disabled, key was run before, busy, no speed), Interrupted, SafetyOpen, UnknownOutcome,
        DeviceFault (the tool enable went off).
        """
        now = await self._ready("tighten", program.speed_rpm)
        joints, memory = joints_of(self._plant), self._memory()
        if key in memory.keys:
            raise DeviceRefused(f"key {key} was run before", device=self.name)
        before = memory.last
        feigned = self._faults.take(self.name, "gripped_nothing", now) is not None
        if feigned:
            program = replace(program, timeout_s=FEIGNED_S)
        self._plant_errors(joints, now)
        active = joints.begin(self._gun, key, program, now, feigned=feigned)
        try:
            await self._run_for(active.end_s - now)
        except (Interrupted, SafetyOpen, DeviceFault):
            joints.stop(self._gun, self._now())
            raise
        now = self._now()
        self._plant.advance(now)
        joints.advance(now)
        if self._faults.take(self.name, "result_lost", now):
            raise UnknownOutcome(f"no result came for {key}", device=self.name)
        if before is not None and self._faults.take(self.name, "result_repeated", now):
            return before
        result = memory.results.get(key)
        if result is None:
            raise Interrupted("halted on the way", device=self.name)
        return result

    async def result(self, key: str) -> TighteningResult | None:
        """What the controller stored under `key`."""
        now = await self._exchange("result")
        joints_of(self._plant).advance(now)
        return self._memory().results.get(key)

    async def halt(self) -> None:
        """Stop the spindle; a running program leaves no result."""
        now = await self._exchange("halt")
        self._stroke.halt()
        joints_of(self._plant).stop(self._gun, now)

    async def safe(self) -> SafeState:
        """Safe while the spindle stands."""
        now = await self._exchange("safe")
        joints_of(self._plant).advance(now)
        turning = self._stroke.under_way or self._memory().active is not None
        return SafeState(not turning, "the spindle turns" if turning else "the spindle stands")

    async def _ready(self, command: str, speed_rpm: float) -> float:
        now = await self._powered(command)
        if not self._plant.tools_enabled:
            raise DeviceRefused("the tool enable is off", device=self.name)
        joints_of(self._plant).advance(now)
        if self._stroke.under_way or self._memory().active is not None:
            raise DeviceRefused("the spindle turns already", device=self.name)
        if not speed_rpm > 0.0:
            raise DeviceRefused(f"speed {speed_rpm} 1/min", device=self.name)
        return now

    async def _run_for(self, seconds: float) -> None:
        """Wait while the spindle turns. Raises Interrupted, and at that very moment SafetyOpen, DeviceFault."""
        end = self._now() + seconds
        while True:
            now = self._now()
            if cut := self._faults.power_cut(now):
                raise SafetyOpen(f"no power ({cut})", device=self.name)
            if now >= end:
                return
            try:
                await self._stroke.run(min(end, self._faults.next_change("safety", now)) - now, device=self.name)
            except Interrupted:
                if self._plant.tools_enabled:
                    raise
                raise DeviceFault("the tool enable went off on the way", device=self.name) from None

    def _enable_changed(self) -> None:
        """Without its enable the spindle stops where it is, whoever waits for it."""
        if not self._plant.tools_enabled and isinstance(self._plant.joints, Joints):
            self._stroke.halt()
            self._plant.joints.stop(self._gun, self._now())

    def _plant_errors(self, joints: Joints, now: float) -> None:
        """Errors that the fault file plants in the joint before this gun, or in the one that it names."""
        here = joints.joint_at(self._gun, now)
        for error in PLANTED:
            fault = self._faults.active(self.name, error, now)
            if fault is not None and here == round(fault.number) and self._faults.take(self.name, error, now):
                joints.plant_error(here, error)

    def _memory(self) -> GunMemory:
        return joints_of(self._plant).guns[self._gun]

    def _now(self) -> float:
        return asyncio.get_running_loop().time()


def joints_of(plant: Plant) -> Joints:
    """The plant's nuts and guns. Raises ConfigError on a bench without them."""
    if not isinstance(plant.joints, Joints):
        raise ConfigError("the plant has no nuts", place="plant.joints")
    return plant.joints


def install_joints(plant: Plant, *, nuts_by_hand: bool = False) -> Joints:
    """Give the plant its nuts and guns; returns them."""
    joints = Joints(plant, nuts_by_hand=nuts_by_hand)
    plant.joints = joints
    return joints
