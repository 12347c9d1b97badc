"""The cell: every device by its name in the cell file, behind latch, motion rules and force guard.

This is the one place that knows backends; they are imported only where the cell file asks for them.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from hal.config import CellConfig
from hal.entries import Devices, ForceLineEntry
from hal.errors import ConfigError, DeviceError, DeviceTimeout, NotConnected, SafetyOpen
from hal.guard.enable import EnableKeeper
from hal.guard.heartbeat import BEATS, Heartbeat
from hal.guard.inloop import InLoopGuard
from hal.interfaces import (
    Axis,
    CameraPark,
    Chuck,
    Device,
    EnableOutput,
    ForceGuard,
    ForceSensor,
    GapProbe,
    Gun,
    Heater,
    Identity,
    NutFeeder,
    PartStation,
    SafetyInputs,
    Scanner,
    Thermometer,
    ToolEnable,
)
from hal.interlocks import Permits
from hal.latch import Latch
from hal.permits import AXES, AxisName, PermitLimits, safety_refusal
from hal.permitted import (
    PermittedAxis,
    PermittedCameraPark,
    PermittedChuck,
    PermittedGun,
    PermittedHeater,
    PermittedNutFeeder,
)
from hal.safe_stop import SafeReport, make_all_safe

if TYPE_CHECKING:
    from hal.fake.devices.scanner import Render
    from hal.fake.faults import FaultBook
    from hal.fake.plant import Plant
    from hal.guard.link import GuardLink
    from hal.real.build import Guarded

__all__ = ["Behind", "Cell", "CellFailure", "SafeReport", "build_cell"]

T = TypeVar("T")
_log = logging.getLogger(__name__)

EXCHANGE_DEADLINE_S = 5.0
"""Connecting, re-arming or closing one device may take so long."""
SAFETY_LOOK_S = 0.25
"""Between two looks at the safety inputs of a running cell."""


class CellFailure(DeviceError):
    """Several devices failed at once; `failures` has each by name, the text those together that have one reason."""

    code = "devices_failed"

    def __init__(self, action: str, failures: Mapping[str, Exception], total: int) -> None:
        alike: dict[str, list[str]] = {}
        for name, error in failures.items():
            alike.setdefault(str(getattr(error, "reason", error)), []).append(name)
        listed = "; ".join(f"{', '.join(names)}: {reason}" for reason, names in alike.items())
        super().__init__(f"{len(failures)} of {total} devices did not {action}: {listed}")
        self.failures = dict(failures)


class CellGuard(ForceGuard, Protocol):
    """A force guard whose life is the cell's."""

    @property
    def alive(self) -> bool: ...
    async def open(self) -> None: ...
    async def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Cell:
    """All devices of one cell. Those that move or heat are behind `latch` and the motion rules of hal.permits."""

    stage_x: Axis
    stage_y: Axis
    jack: Axis
    shaft_table: Axis
    gun_table: Axis
    gun_feed: Axis
    gun_a: Gun
    gun_b: Gun
    jack_force: ForceSensor
    gun_force_a: ForceSensor
    gun_force_b: ForceSensor
    spigot_tc_1: Thermometer
    spigot_tc_2: Thermometer
    pyrometer: Thermometer
    rotor_tc: Thermometer
    heater: Heater
    chuck: Chuck
    camera_park: CameraPark
    nut_feeder: NutFeeder
    tool_enable: ToolEnable
    gap_probe_1: GapProbe
    gap_probe_2: GapProbe
    gap_probe_3: GapProbe
    safety: SafetyInputs
    part_station: PartStation
    scanner: Scanner
    guard: CellGuard
    latch: Latch
    heartbeat: Heartbeat | None = None

    def devices(self) -> tuple[Device, ...]:
        """Every device, in the order of the cell file."""
        return tuple(getattr(self, name) for name in Devices.model_fields)

    async def connect(self) -> dict[str, Identity]:
        """Connect all devices at once and prove who they are.

        Raises CellFailure with every device that failed; the others stay connected, and connecting again is harmless.
        """
        if self.heartbeat is not None:
            self.heartbeat.start()
        with contextlib.suppress(NotConnected):  # the devices behind it say so, with all others that failed
            await self.guard.open()
        return await _all("connect", self.devices(), lambda device: device.connect())

    async def close(self) -> None:
        """Close guard and devices. Never raises, leaves no task."""
        await self.guard.close()
        await asyncio.gather(*(_quietly(device.close()) for device in self.devices()))
        if self.heartbeat is not None:
            await self.heartbeat.close()

    async def make_safe(self, deadline_s: float, reason: str = "the cell was stopped") -> SafeReport:
        """Halt everything at once and read back whether it is safe, within `deadline_s`; motion then needs `rearm`.

        It goes on to its end even when its caller is cancelled, and may be called again at any time.
        """
        stop = make_all_safe(self.devices(), self.latch, reason, deadline_s)
        return await asyncio.shield(asyncio.get_running_loop().create_task(stop, name="make safe"))

    async def rearm(self) -> None:
        """Make every set-point the measured value and open the latch: nothing old is resumed.

        Raises SafetyOpen while a safety input is open or unknown, CellFailure with every device that did not re-arm,
        GuardTripped or a DeviceError where the guard did not; the latch then stays closed.
        """
        self.latch.close("safe stop", "not re-armed to the end")
        await _all("re-arm", [self.safety], lambda device: device.rearm())
        if reason := await self._safety():
            raise SafetyOpen(reason)
        await self.guard.disarm()
        await self.guard.rearm()  # before the drives: the gate of a guard process lets no drive be enabled until then
        await _all("re-arm", self.devices(), lambda device: device.rearm())
        self.latch.open("safe stop")

    async def until_unsafe(self) -> str:
        """Returns the reason once a safety input is open or unknown; waits for as long as all are closed."""
        while True:
            if reason := await self._safety():
                return reason
            await asyncio.sleep(SAFETY_LOOK_S)

    async def _safety(self) -> str | None:
        try:
            async with asyncio.timeout(EXCHANGE_DEADLINE_S):
                return safety_refusal(await self.safety.read())
        except (DeviceError, TimeoutError):
            return safety_refusal(None)


@dataclass(frozen=True, slots=True)
class Behind:
    """What stands behind fakes: the plant, how they fail, and what computes the scanner's clouds."""

    plant: Plant
    faults: FaultBook
    render: Render


def build_cell(config: CellConfig, behind: Behind | None = None) -> Cell:
    """The cell of `config`, not connected; `behind` is needed where one of its devices is fake.

    Nothing here starts a task or talks to a device. Raises ConfigError.
    """
    latch, envelope = Latch(), config.envelope
    link = _guard_link(config)
    bare, beat = _bare(config, behind, link)
    axes: dict[AxisName, Axis] = {name: bare[name] for name in AXES}
    guard = _guard(config, bare["jack_force"], tuple(axes.values()), latch, link)
    limits = PermitLimits(
        view_safe_mm=envelope.view_safe_mm,
        free_mm=envelope.free_mm,
        guns_back_mm=envelope.guns_back_mm,
        pressure_low_bar=envelope.chuck_pressure_low_bar,
        read_s=envelope.read_s,
    )
    if link is None or config.devices.tool_enable.kind == "fake":
        bare["tool_enable"] = _kept(config, bare["tool_enable"], guard, latch)
    looked_at = (bare["chuck"], bare["camera_park"], bare["safety"], bare["tool_enable"])
    permits = Permits(axes, *looked_at, guard, limits, latch)
    permitted: dict[str, Any] = {
        name: PermittedAxis(name, axis, permits, getattr(config.devices, name).in_position)
        for name, axis in axes.items()
    }
    permitted |= {
        "gun_a": PermittedGun(bare["gun_a"], permits),
        "gun_b": PermittedGun(bare["gun_b"], permits),
        "heater": PermittedHeater(bare["heater"], permits),
        "chuck": PermittedChuck(bare["chuck"], permits),
        "camera_park": PermittedCameraPark(bare["camera_park"], permits),
        "nut_feeder": PermittedNutFeeder(bare["nut_feeder"], permits),
    }
    heartbeat = Heartbeat(beat, lambda: guard.alive, _beat_s(config)) if beat is not None else None
    return Cell(guard=guard, latch=latch, heartbeat=heartbeat, **(bare | permitted))


def _guard_link(config: CellConfig) -> GuardLink | None:
    """The way to the guard where it is a process of its own."""
    if config.guard.process == "in_loop":
        return None
    from hal.guard.child import GuardChild
    from hal.guard.link import GuardLink

    child = GuardChild(config.path) if config.guard.process == "child" else None
    return GuardLink(config.beside(config.guard.socket), child)


def _guard(
    config: CellConfig, sensor: ForceSensor, axes: Sequence[Axis], latch: Latch, link: GuardLink | None
) -> CellGuard:
    delays, deadline_s = config.guard, config.cell.safe_deadline_s
    if link is not None:
        from hal.guard.client import GuardClient

        frozen = delays.frozen_samples
        return GuardClient(link, sensor, axes, latch, halt_deadline_s=deadline_s, frozen_samples=frozen)
    return InLoopGuard(
        sensor,
        axes,
        latch,
        idle_block=delays.idle_block,
        idle_stale_s=delays.stale_ms * 1e-3,
        halt_deadline_s=deadline_s,
        frozen_samples=delays.frozen_samples,
    )


def _kept(config: CellConfig, output: EnableOutput, guard: CellGuard, latch: Latch) -> EnableKeeper:
    """The output that lets the guns turn, kept by the guard that shares this loop."""
    watchdog_s: float = getattr(config.devices.tool_enable, "watchdog_s", 0.0)

    def refused() -> str:
        return latch.reason("guard") if guard.alive else "the guard has died"

    keeper = EnableKeeper(output, refused, watchdog_s)
    latch.on_change = keeper.look
    return keeper


def _bare(
    config: CellConfig, behind: Behind | None, link: GuardLink | None
) -> tuple[dict[str, Any], Callable[[], None] | None]:
    """Every device as its entry says, without any rules, and what is told in time that this controller lives."""
    devices: dict[str, Any] = {}
    beat: Callable[[], None] | None = None
    fakes = [name for name, kind in config.kinds.items() if kind == "fake"]
    if fakes:
        if behind is None:
            raise ConfigError(f"a fake needs a plant behind it: {', '.join(fakes)}", place="devices")
        from hal.fake.devices.build import fake_devices

        devices = fake_devices(config, behind.plant, behind.faults, behind.render, fakes)
    if len(fakes) < len(config.kinds):
        from hal.real.build import real_devices

        real = real_devices(config, _guarded(config, link) if link is not None else None)
        devices |= real.devices
        beat = link.beat if link is not None else real.can.beat if real.can is not None else None
    return devices, beat


def _guarded(config: CellConfig, link: GuardLink) -> Guarded:
    from hal.guard.enable_client import GuardedToolEnable
    from hal.guard.force import RingForceSensor
    from hal.real.build import Guarded

    entry = config.devices.jack_force
    assert isinstance(entry, ForceLineEntry), "the cell file was checked"
    devices: dict[str, Any] = {
        "jack_force": RingForceSensor("jack_force", entry, link, config.beside(config.guard.socket))
    }
    if config.devices.tool_enable.kind != "fake":
        devices["tool_enable"] = GuardedToolEnable("tool_enable", link)
    return Guarded(link, devices)


def _beat_s(config: CellConfig) -> float:
    """Between two beats, which go to the guard, or to the drives where it shares this loop."""
    return (config.consumer_s if config.guard.process == "in_loop" else config.guard.beat_ms * 1e-3) / BEATS


async def _all(action: str, devices: Iterable[Device], do: Callable[[Device], Awaitable[T]]) -> dict[str, T]:
    """`do` with all devices at once, each within its own deadline. Raises CellFailure naming every one that failed."""
    asked = tuple(devices)

    async def one(device: Device) -> T:
        try:
            async with asyncio.timeout(EXCHANGE_DEADLINE_S):
                return await do(device)
        except TimeoutError:
            raise DeviceTimeout(f"did not {action} within {EXCHANGE_DEADLINE_S:g} s", device=device.name) from None

    answers = await asyncio.gather(*(one(device) for device in asked), return_exceptions=True)
    done: dict[str, T] = {}
    failures: dict[str, Exception] = {}
    for device, answer in zip(asked, answers, strict=True):
        if isinstance(answer, Exception):
            failures[device.name] = answer
        elif isinstance(answer, BaseException):
            raise answer
        else:
            done[device.name] = answer
    if failures:
        raise CellFailure(action, failures, len(asked))
    return done


async def _quietly(closing: Awaitable[None]) -> None:
    try:
        async with asyncio.timeout(EXCHANGE_DEADLINE_S):
            await closing
    except Exception:
        _log.exception("a device did not close")
