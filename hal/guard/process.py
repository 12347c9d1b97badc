"""The guard as a process: CAN adapter, jack force, gate and heartbeats behind one Unix socket and one ring of samples.

Everything that decides is in `hal.guard.sentry`; here are the wires. Samples are looked at when they come, in the
callback that reads the port.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hal.bus.can import CanBus
from hal.bus.modbus import Lines
from hal.codec import guard as wire
from hal.codec.cia301 import HEARTBEAT, RPDO1, SDO_REQUEST, heartbeat, pack
from hal.codec.cia402 import CONTROLWORD, LAYOUTS, MODE, QUICK_STOP, Mode
from hal.codec.guard import Kind
from hal.codec.lawicel import CanFrame
from hal.codec.sdo import download
from hal.config import CellConfig
from hal.entries import CanAxisEntry, CanEntry, ForceLineEntry, ModbusEnableEntry
from hal.errors import CellError, DeviceError, NotConnected, SafetyOpen
from hal.guard.enable import EnableKeeper
from hal.guard.files import ring_beside
from hal.guard.heartbeat import BEATS
from hal.guard.logic import Trip
from hal.guard.ring import RingWriter
from hal.guard.sentry import Sentry
from hal.guard.server import Server
from hal.interfaces import ForceBlock, GuardLimits
from hal.real.force import SerialForceSensor
from hal.real.modbus_devices import beside, modbus_device

RETRY_S = 0.2
"""Between two attempts to have the sensor or the adapter back."""
_log = logging.getLogger(__name__)


class GuardProcess:
    """Made inside the running loop. `can_bus` is not open; `start` does not wait for adapter or sensor.

    `on_cycle` is called with the loop's time whenever the heartbeats are due.
    """

    def __init__(self, config: CellConfig, can_bus: CanBus, on_cycle: Callable[[float], None] | None = None) -> None:
        self._on_cycle = on_cycle
        entry = config.devices.jack_force
        assert isinstance(entry, ForceLineEntry), "the cell file was checked"
        assert isinstance(config.can, CanEntry), "the cell file was checked"
        axes = {name: one for name, one in config.entries.items() if isinstance(one, CanAxisEntry)}
        self._node = config.can.node
        self._nodes = [axes[name].node for name in sorted(axes, key=lambda name: name != "jack")]
        self._silence_s = max((one.silence_s for one in axes.values()), default=0.3)
        self._loop = asyncio.get_running_loop()
        self._bus = can_bus
        self._cycle_s = config.consumer_s / BEATS
        self.sentry = Sentry(
            self._stop,
            self._tell,
            beat_s=config.guard.beat_ms * 1e-3,
            quiet_s=config.guard.quiet_ms * 1e-3,
            consumer_s=config.consumer_s,
            frozen_samples=config.guard.frozen_samples,
        )
        path = entry.model_copy(update={"path": str(config.beside(entry.path))})
        self._sensor = SerialForceSensor("jack_force", path, self._samples)
        self._sensor_error: DeviceError | None = NotConnected("not connected yet", device="jack_force")
        self._enable = self._keeper(config)
        self._devices: dict[str, Any] = {"jack_force": self._sensor}
        if self._enable is not None:
            self._devices["tool_enable"] = self._enable
        socket = config.beside(config.guard.socket)
        socket.parent.mkdir(parents=True, exist_ok=True)
        self.server = Server(socket, self._came, self._left, self._message)
        self._ring = RingWriter(ring_beside(socket))
        self._arming: list[int] = []
        self._watches: list[Any] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._timer: asyncio.TimerHandle | None = None
        self._next_cycle: asyncio.TimerHandle | None = None

    def _keeper(self, config: CellConfig) -> EnableKeeper | None:
        """Of the output that lets the guns turn, where it has a wire."""
        entry = config.devices.tool_enable
        if not isinstance(entry, ModbusEnableEntry):
            return None
        output = modbus_device("tool_enable", beside(config, entry), Lines())
        return EnableKeeper(output, lambda: "the guard has tripped" * self.sentry.gate.latched, entry.watchdog_s)

    async def start(self) -> None:
        """Listen, and have adapter and sensor as soon as they are there. Raises OSError: the socket cannot be had."""
        await self.server.start()
        self._bus.ears.every(self)
        self._spawn(self._tend_bus())
        self._spawn(self._tend_sensor())
        self._cycle()

    async def close(self) -> None:
        """Stop the drives, give everything back; no task is left."""
        self.sentry.latch(Trip("the guard was shut down"))
        await self.server.close()
        for timer in (self._timer, self._next_cycle):
            if timer is not None:
                timer.cancel()
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)
        if self._enable is not None:
            await self._enable.close()
        await self._sensor.close()
        self._ring.close()

    def _spawn(self, work: Any) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # ------------------------------------------------------------ wires

    async def _tend_bus(self) -> None:
        """Keep the adapter; once it is open, the bus itself sees to it."""
        while True:
            try:
                await self._bus.open()
                break
            except NotConnected as error:
                _log.warning("%s", error)
                await asyncio.sleep(RETRY_S)
        try:
            await self._loop.create_future()
        finally:
            await self._bus.release()

    async def _tend_sensor(self) -> None:
        """Read on: what is wrong with the line shows here, and each next attempt opens it anew."""
        while True:
            try:
                if self._sensor_error is not None:
                    await self._sensor.connect()
                await self._sensor.block(max(1, round(self._sensor.rate_hz)))
            except DeviceError as error:
                self._sensor_error = error
                self._tell()
                await asyncio.sleep(RETRY_S)

    def _samples(self, block: ForceBlock) -> None:
        self.sentry.samples(block, self._loop.time())
        times_s = block.time_s + block.period_s * np.arange(len(block.samples_n), dtype=np.float64)
        self._ring.put(block.sequence, times_s, block.samples_n)
        if self._sensor_error is not None:
            self._sensor_error = None
            self._tell()

    def frame(self, frame: CanFrame) -> None:
        """A frame of the bus, for the controller."""
        self.server.send(wire.encode_frame(frame, self.sentry.gate.epoch))

    def down(self, reason: str) -> None:
        """The adapter is lost, or back and lost."""
        self._tell()

    def _stop(self) -> None:
        """Quick stop to every drive, the jack's first; by SDO as well, for one that takes no PDOs just now. Then the
        guns."""
        word = pack(LAYOUTS[RPDO1], {CONTROLWORD: QUICK_STOP, MODE: Mode.PROFILE_POSITION})
        written = next(download(CONTROLWORD.index, CONTROLWORD.sub, CONTROLWORD.encode(QUICK_STOP)))
        with contextlib.suppress(NotConnected):  # then they stop for want of a heartbeat
            for node in self._nodes:
                self._bus.send(CanFrame(RPDO1 + node, word))
            for node in self._nodes:
                self._bus.send(CanFrame(SDO_REQUEST + node, written))
        if self._enable is not None:
            self._enable.look()

    # ------------------------------------------------------------ time

    def _cycle(self) -> None:
        """The heartbeats: to the drives while the controller lives, to the others always."""
        self._beat()
        self._tell()
        if self._on_cycle is not None:
            self._on_cycle(self._loop.time())
        self._next_cycle = self._loop.call_later(self._cycle_s, self._cycle)

    def _beat(self) -> None:
        now = self._loop.time()
        if self.sentry.heartbeat_due(now):
            with contextlib.suppress(NotConnected):
                self._bus.send(heartbeat(self._node))
                self.sentry.heartbeat_sent(now)

    def _look(self) -> None:
        """The timer is set anew when it falls due, not with every sample."""
        self._timer = None
        now = self._loop.time()
        if now >= self.sentry.due_s():
            self.sentry.look(now + 1e-9)
        self._set()

    def _set(self) -> None:
        if self._timer is None and math.isfinite(due_s := self.sentry.due_s()):
            self._timer = self._loop.call_at(due_s + 1e-6, self._look)

    # ------------------------------------------------------------ the controller

    def _came(self) -> None:
        for node in self._nodes:
            self._watches.append(self._bus.watch(HEARTBEAT + node, self._silence_s, lambda: None))
        self._tell()

    def _left(self) -> None:
        for end in self._watches:
            end()
        self._watches.clear()
        self._arming.clear()
        self.sentry.gone()

    def _message(self, kind: Kind, body: bytes) -> None:
        """Raises GuardMessageError, KeyError, TypeError, ValueError: the other side speaks something else."""
        match kind:
            case Kind.FRAME:
                frame, epoch = wire.decode_frame(body)
                # The drives' heartbeat is the guard's alone.
                if frame.can_id != HEARTBEAT + self._node and self.sentry.passes(frame, epoch, self._loop.time()):
                    with contextlib.suppress(NotConnected):
                        self._bus.send(frame)
            case Kind.BEAT:
                self.sentry.look(self._loop.time())
                self.sentry.beat(self._loop.time())
            case Kind.CALL:
                values = wire.decode_object(body)
                self._call(int(values.pop("tag")), str(values.pop("do")), values)

    def _call(self, tag: int, do: str, values: dict[str, Any]) -> None:
        match do:
            case "arm":
                self._arming.append(tag)
                self.sentry.arm(GuardLimits(**values), self._loop.time())
                self._set()
                self._tell()
            case "disarm":
                self.sentry.disarm()
                self._tell()
                self._answer(tag)
            case "clear":
                self._beat()
                refused = self.sentry.clear(int(values["epoch"]), self._loop.time())
                if self._enable is not None:
                    self._enable.look()
                self._tell()
                self._answer(tag, NotConnected(f"{refused} {self._bus.trouble}".strip()) if refused else None)
            case _:
                self._spawn(self._device_call(tag, do, str(values["device"])))

    async def _device_call(self, tag: int, do: str, name: str) -> None:
        """What the controller does with a device that is the guard's."""
        device = self._devices[name]
        try:
            match do:
                case "connect":
                    identity = await device.connect()
                    if device is self._sensor:
                        self._sensor_error = None
                    self._tell()
                    self._answer(tag, **dataclasses.asdict(identity))
                case "safe":
                    self._answer(tag, **dataclasses.asdict(await device.safe()))
                case "halt":
                    await device.halt()
                    self._tell()
                    self._answer(tag)
                case "rearm":
                    await device.rearm()
                    self._tell()
                    self._answer(tag)
        except (DeviceError, SafetyOpen) as error:
            self._answer(tag, error)

    def _answer(self, tag: int, error: CellError | None = None, **values: Any) -> None:
        wrong = {"error": error.code, "reason": error.reason, "device": error.device} if error else {"is": values}
        self.server.send(wire.encode_object(Kind.ANSWER, {"tag": tag} | wrong))

    def _tell(self) -> None:
        """What the guard knows; then the answers to those who wait for a first sample, or for a trip."""
        sentry, error = self.sentry, self._sensor_error
        told = dataclasses.asdict(sentry.state(self._loop.time())) | {
            "epoch": sentry.gate.epoch,
            "force_n": sentry.trip.force_n if sentry.trip else math.nan,
            "bus": self._bus.trouble,
            "sensor": [error.code, error.reason] if error else None,
            "tools": self._enable.reason if self._enable else "",
        }
        self.server.send(wire.encode_object(Kind.STATE, told))
        if self._arming and (sentry.trip is not None or sentry.proven or not sentry.armed):
            for tag in self._arming:
                self._answer(tag)
            self._arming.clear()
