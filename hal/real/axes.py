"""Axes over CANopen (CiA 402), `hal.interfaces.Axis`.

What a drive says is always asked for by SDO; its PDOs only wake whoever waits. So every answer is younger than the
question, whatever the bus lost, doubled or delayed. A controlword goes by RPDO, and its effect is seen in the
statusword. A motion that does not get its answers in time is ended by a quick stop and never begun again unasked.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Literal

from hal.bus.canopen import Node
from hal.bus.ears import Link
from hal.codec import cia402 as drive
from hal.codec.cia301 import NO_VENDOR, PRODUCT, REVISION, RPDO1, RPDO2, SERIAL, VENDOR, NmtCommand
from hal.codec.cia402 import Mode, State, Status, Step
from hal.entries import CanAxisEntry
from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted, NotConnected, SafetyOpen
from hal.interfaces import AxisLimits, AxisState, Identity, SafeState
from hal.real.axis_settings import counts, expected, pdo_settings, settings

ANSWER_S = 2.0
"""A halt, a change of state or a step of a handshake must have its answer by then."""
POLL_S = 0.1
"""Between two looks at the statusword where no PDO calls for one."""
ARRIVAL_S = 5.0
"""Beyond the time that a motion takes."""
HOMING_S = 30.0
"""Likewise for homing."""


class CanAxis:
    """One drive. `controller` is the node whose heartbeat it expects."""

    def __init__(
        self, name: str, unit: Literal["mm", "deg"], entry: CanAxisEntry, link: Link, *, controller: int = 127
    ) -> None:
        self.name = name
        self.unit: Literal["mm", "deg"] = unit
        self.limits = AxisLimits(entry.low, entry.high, entry.max_speed, entry.max_acceleration)
        self._entry = entry
        self.link = link
        self._controller = controller
        self.node = Node(link, entry.node, name, silence_s=entry.silence_s, reply_s=entry.reply_s)
        """The drive as a CANopen node."""
        self._connected = False
        self._boots = 0
        self._mode = Mode.PROFILE_POSITION
        self._ramp = 0
        self._commanded = False
        self._halted = False
        self._begun = False

    # ------------------------------------------------------------ link

    async def connect(self) -> Identity:
        """Prove identity and scale, set what keeps the axis safe, read it back, start the PDOs.

        Raises NotConnected, DeviceTimeout, DeviceRefused (identity or scale are not the cell file's), DeviceFault.
        """
        if not self._connected:
            await self.node.open()
        try:
            identity = await self._identify()
            if not self._connected or self.node.boots != self._boots:
                await self._configure()
        except BaseException:
            await self.close()
            raise
        self._connected = True
        return identity

    async def close(self) -> None:
        """Drop the link. A drive in motion is stopped; without the controller's heartbeat it would stop by itself."""
        if self._connected and self._commanded:
            self._quick_stop()
        opened, self._connected = self.node.opened, False
        if opened:
            await self.node.close()

    async def _identify(self) -> Identity:
        node = self.node
        vendor, product, revision, serial = [await node.upload(one) for one in (VENDOR, PRODUCT, REVISION, SERIAL)]
        for one, value in expected(self._entry).items():
            if (said := await node.upload(one)) != value:
                raise DeviceRefused(f"{one} of the drive is {said}, the cell file says {value}", device=self.name)
        return Identity(
            vendor=f"CiA vendor {vendor:#x}" if vendor != NO_VENDOR else "cellctl",
            model=await node.text(0x1008) or f"{product:#x}",
            serial=str(serial),
            firmware=await node.text(0x100A) or f"{revision:#x}",
            simulated=vendor == NO_VENDOR,
        )

    async def _configure(self) -> None:
        """In pre-operational, where nothing is mapped while it is in use. A drive that still moves is stopped first."""
        self._boots = self.node.boots
        if not (await self._status()).at_rest:
            await self._stop()
        self.node.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        for entry, value in pdo_settings(self._entry):
            await self.node.download(entry, value)
        for entry, value in settings(self._entry, self._controller).items():
            await self.node.set(entry, value)
        self._ramp = counts(self._entry, self._entry.max_acceleration)
        self.node.command(NmtCommand.START)

    # ------------------------------------------------------------ reading

    async def read(self) -> AxisState:
        """What the drive says, asked just now."""
        self._require("read")
        return (await self._look())[1]

    async def safe(self) -> SafeState:
        """Safe while the drive says that it stands and its encoder agrees; with a brake: and something holds it."""
        self._require("safe")
        status, state = await self._look()
        if state.moving:
            return SafeState(False, f"{self.name} is moving ({status.state.name.lower()})")
        held = "brake closed" if state.brake_closed else "held by the drive" if status.held else "without torque"
        stop = ", quick stop active" if status.state is State.QUICK_STOP_ACTIVE else ""
        return SafeState(
            status.held or state.brake_closed or not self._entry.brake,
            f"{self.name} stands at {state.position:.3f} {self.unit}, {held}{stop}",
        )

    async def _look(self) -> tuple[Status, AxisState]:
        """The statusword is asked first: what it calls reached is not measured on the way."""
        node, scale = self.node, self._entry.counts_per_unit
        status = await self._status()
        velocity = await node.upload(drive.VELOCITY) / scale
        position = await node.upload(drive.POSITION) / scale
        outputs = await node.upload(drive.OUTPUTS) if self._entry.brake else 0
        state = AxisState(
            position=position,
            velocity=velocity,
            homed=status.bit(self._entry.referenced_bit),
            enabled=status.state is State.OPERATION_ENABLED,
            brake_closed=bool(outputs & drive.BRAKE_SET),
            moving=not status.at_rest or abs(velocity) > self._entry.standstill,
            time_s=asyncio.get_running_loop().time(),
        )
        return status, state

    async def _status(self) -> Status:
        return Status(await self.node.upload(drive.STATUSWORD))

    def _require(self, command: str) -> None:
        if not self._connected:
            raise NotConnected(f"not connected ({command})", device=self.name)

    # ------------------------------------------------------------ stopping

    async def halt(self) -> None:
        """Quick stop; returns once the drive says that it stands in it. A standing axis only acknowledges."""
        self._require("halt")
        self._halted = self._commanded
        if not self._commanded:
            status = await self._status()
            if status.held and status.at_rest:
                return
        await self._stop()

    async def _stop(self) -> None:
        self._quick_stop()
        node = self.node
        try:
            async with asyncio.timeout(ANSWER_S):
                while True:
                    seen = node.tidings
                    status = await self._status()
                    if status.state is State.OPERATION_ENABLED:  # its RPDO is off or was lost: acknowledged, then
                        await node.download(drive.CONTROLWORD, drive.QUICK_STOP)
                    elif status.at_rest and abs(await node.upload(drive.VELOCITY)) <= self._standstill:
                        return
                    await node.news(seen, POLL_S)
        except TimeoutError:
            raise DeviceTimeout(f"quick stop not acknowledged within {ANSWER_S:g} s", device=self.name) from None

    def _quick_stop(self) -> None:
        with contextlib.suppress(NotConnected):  # then the drive stops for want of the controller's heartbeat
            self._control(drive.QUICK_STOP)

    def _control(self, word: int) -> None:
        self.node.put(RPDO1, {drive.CONTROLWORD: word, drive.MODE: self._mode})

    @property
    def _standstill(self) -> float:
        return self._entry.standstill * self._entry.counts_per_unit

    async def rearm(self) -> None:
        """Out of quick stop or fault, the target where the axis stands. Without power only the target is set."""
        self._require("rearm")
        node = self.node
        if node.boots != self._boots:
            await self._configure()
        _, state = await self._look()
        if self._commanded or state.moving:
            raise DeviceRefused("is moving", device=self.name)
        await node.set(drive.TARGET, await node.upload(drive.POSITION))
        node.emergency = None
        if (await self._status()).voltage:
            await self._enable()

    async def _enable(self) -> None:
        self._mode = Mode.PROFILE_POSITION
        node, before = self.node, None
        status = await self._status()
        try:
            async with asyncio.timeout(ANSWER_S):
                while status.state is not State.OPERATION_ENABLED:
                    seen = node.tidings
                    word = drive.toward_enabled(status.state)
                    if word is not None and status.state is not before:
                        self._control(word)
                        before = status.state
                    await node.news(seen, POLL_S)
                    status = await self._status()
        except TimeoutError:
            raise DeviceFault(
                f"stays in {status.state.name.lower()}: {await self._error()}", device=self.name
            ) from None

    # ------------------------------------------------------------ motion

    async def home(self) -> AxisState:
        """Find the reference by the drive's own homing. Raises as `move_to` does."""
        async with self._command("home"):
            travel_s = (self.limits.high - self.limits.low) / (self._entry.homing_share * self.limits.max_speed)
            await self._switch(Mode.HOMING)
            await self._follow(drive.homing_step, drive.HOMING_WORDS, 2.0 * travel_s + HOMING_S)
            await self._switch(Mode.PROFILE_POSITION)
        return await self.read()

    async def move_to(self, position: float, *, speed: float) -> AxisState:
        """See `hal.interfaces.Axis.move_to`. An axis that is on its way refuses a second command."""
        async with self._command("move_to") as status:
            self._judge(status, position, speed)
            speed = min(speed, self.limits.max_speed)
            await self._ramps(min(self.limits.max_acceleration, speed / self._entry.ramp_s))
            way = abs(position - await self.node.upload(drive.POSITION) / self._entry.counts_per_unit)
            await self._target(counts(self._entry, position), max(counts(self._entry, speed), 1))
            await self._follow(drive.position_step, drive.POSITION_WORDS, way / speed + self._entry.ramp_s + ARRIVAL_S)
        return await self.read()

    def _judge(self, status: Status, position: float, speed: float) -> None:
        """Raises DeviceRefused."""
        low, high = self.limits.low, self.limits.high
        if not status.bit(self._entry.referenced_bit):
            raise DeviceRefused("is not homed", device=self.name)
        if not low <= position <= high:
            raise DeviceRefused(f"{position:g} {self.unit} is outside {low:g} to {high:g}", device=self.name)
        if not (math.isfinite(speed) and speed > 0.0):
            raise DeviceRefused(f"speed {speed:g} {self.unit}/s is not positive", device=self.name)

    @contextlib.asynccontextmanager
    async def _command(self, command: str) -> AsyncIterator[Status]:
        """One motion at a time, from a drive that can. Whatever ends it early but a halt leaves the drive stopping.

        Raises NotConnected, SafetyOpen, DeviceFault, DeviceRefused.
        """
        self._require(command)
        status = await self._status()
        await self._powered(status)
        if self._commanded or not status.at_rest:
            raise DeviceRefused("is on its way already", device=self.name)
        self._commanded, self._halted, self._begun = True, False, False
        self.node.emergency = None
        try:
            yield status
        except Interrupted:
            raise
        except BaseException:
            if self._begun:
                self._quick_stop()
            raise
        finally:
            self._commanded = False

    async def _powered(self, status: Status) -> None:
        if not status.voltage:
            raise SafetyOpen("no power", device=self.name)
        if status.state in (State.FAULT, State.FAULT_REACTION):
            raise DeviceFault(await self._error(), device=self.name)
        if self.node.boots != self._boots:
            raise DeviceFault("restarted and has lost its settings: re-arm first", device=self.name)
        if status.state is not State.OPERATION_ENABLED:
            raise DeviceRefused(f"{status.state.name.lower().replace('_', ' ')}: re-arm first", device=self.name)

    async def _ramps(self, acceleration: float) -> None:
        """A creeping axis starts and stops gently, so that its ramps do not look like a contact force."""
        ramp = max(counts(self._entry, acceleration), 1)
        if ramp != self._ramp:
            self._ramp = 0
            await self.node.set(drive.PROFILE_ACCELERATION, ramp)
            await self.node.set(drive.PROFILE_DECELERATION, ramp)
            self._ramp = ramp

    async def _target(self, target: int, speed: int) -> None:
        """Set-point by RPDO, which nobody acknowledges: so it is read back before the drive is told to go there."""
        values = {drive.TARGET: target, drive.PROFILE_VELOCITY: speed}
        self.node.put(RPDO2, values)
        for entry, value in values.items():
            if (back := await self.node.upload(entry)) != value:
                raise DeviceFault(f"{entry} was set to {value} and reads {back}", device=self.name)

    async def _switch(self, mode: Mode) -> None:
        """To another mode of operation, proven by the drive's display."""
        self._mode = mode
        self._control(drive.ENABLE)
        node, until = self.node, asyncio.get_running_loop().time() + ANSWER_S
        while await node.upload(drive.MODE_SHOWN) != mode:
            seen = node.tidings
            await self._refuse(await self._status())
            if asyncio.get_running_loop().time() > until:
                raise DeviceTimeout(f"does not go to {mode.name.lower()} within {ANSWER_S:g} s", device=self.name)
            await node.news(seen, POLL_S)

    async def _follow(
        self, answer: Callable[[Step, Status], Step], words: Mapping[Step, int], arrival_s: float
    ) -> None:
        """Lead the drive through one motion, from the first controlword to "reached". Raises as `move_to`."""
        node, loop, step = self.node, asyncio.get_running_loop(), Step.CLEAR
        arrive_by = loop.time() + arrival_s
        until = loop.time() + ANSWER_S
        self._control(words[step])
        while True:
            seen = node.tidings
            status = await self._status()
            await self._refuse(status)
            if (after := answer(step, status)) is Step.DONE:
                return
            if after is not step:
                step, until = after, arrive_by if after is Step.TRAVEL else loop.time() + ANSWER_S
                self._begun = True
                self._control(words[step])
            elif loop.time() > until:
                raise DeviceTimeout(f"no answer of the drive while {step.value}", device=self.name)
            else:
                await node.news(seen, min(POLL_S, until - loop.time() + 1e-3))

    async def _refuse(self, status: Status) -> None:
        """Why a motion under way has ended; nothing while it goes on. Raises as `move_to`."""
        said = self.node.emergency
        if self._halted and (said is None or not status.voltage):
            raise Interrupted("halted on the way", device=self.name)
        if self.node.boots != self._boots:
            raise DeviceFault("restarted on the way", device=self.name)
        if not status.voltage:
            raise SafetyOpen("stopped, no power", device=self.name)
        if said is not None and (self._halted or status.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)):
            # A quick stop of its own is undone by a controlword that was still on its way, and then looks arrived. It
            # is felt by the force guard too, whose halt must not hide what came first.
            raise DeviceFault(f"reported {drive.error_text(said.code)} on the way", device=self.name)
        if status.state is State.OPERATION_ENABLED:
            if status.bit(drive.DEVIATION):
                raise DeviceFault(f"following or homing error: {await self._error()}", device=self.name)
            return
        if status.state is State.FAULT_REACTION:
            return  # it stops; the fault comes when it stands
        if status.state is State.QUICK_STOP_ACTIVE:
            raise Interrupted("halted on the way", device=self.name)
        reason = await self._error()
        await asyncio.sleep(POLL_S)  # a drive may leave its state a moment before it says that the power has gone
        if not (await self._status()).voltage:
            raise SafetyOpen("stopped, no power", device=self.name)
        raise DeviceFault(f"stopped by itself: {reason}", device=self.name)

    async def _error(self) -> str:
        """The drive's own reason, from its error code; where that is gone, from its last emergency message."""
        code = await self.node.upload(drive.ERROR_CODE)
        if code == 0 and self.node.emergency is not None:
            code = self.node.emergency.code
        return drive.error_text(code) if code else "no reason given"
