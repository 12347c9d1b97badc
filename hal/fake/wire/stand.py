"""All simulators of one cell file, with one plant behind them, at the addresses that the file names.

Devices of kind fake have no wire and are left out. An address that is not on this machine is refused.
"""

from __future__ import annotations

import contextlib
import ipaddress
import pkgutil
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

from hal.bus.hub import CanHub
from hal.config import CellConfig
from hal.entries import CanAxisEntry, FileDropEntry, ForceLineEntry, GentlEntry, GunEntry, ModbusEntry
from hal.errors import ConfigError
from hal.fake.devices.build import fake_devices
from hal.fake.devices.scanner import Render
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.behind import BehindWire
from hal.fake.wire.can_node import CanNode
from hal.fake.wire.force import ForceAmplifier
from hal.fake.wire.gentl import SimulatedCamera
from hal.fake.wire.gun_memory import Program
from hal.fake.wire.modbus import SimulatedModbus
from hal.fake.wire.scanner import DropFolder

Entry = TypeVar("Entry")
_Server = tuple[str, int, str]
"""Host, port, serial port: what Modbus devices behind one server share."""


class SimulatedGun(Protocol):
    """A tightening controller, whoever made it."""

    starts: list[str]
    """What the programs that were started were told to be for, in order."""

    async def start(self) -> int:
        """Listen; returns the port."""
        ...

    async def close(self) -> None: ...
    def drop(self) -> None:
        """Drop every connection."""
        ...

    @property
    def turning(self) -> bool:
        """Whether a program runs."""
        ...

    async def power_cycle(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Stand:
    """What runs, so that wires can be pulled and devices tampered with; devices by their names in the cell file."""

    hub: CanHub = field(default_factory=CanHub)
    nodes: dict[str, CanNode] = field(default_factory=dict)
    modbus: list[SimulatedModbus] = field(default_factory=list)
    guns: dict[str, SimulatedGun] = field(default_factory=dict)
    forces: dict[str, ForceAmplifier] = field(default_factory=dict)
    scanners: dict[str, DropFolder | SimulatedCamera] = field(default_factory=dict)


@contextlib.asynccontextmanager
async def standing(
    config: CellConfig, plant: Plant, faults: FaultBook, render: Render, programs: Sequence[Program]
) -> AsyncIterator[Stand]:
    """Start everything, take everything down at the end. The plant has its heat and its nuts.

    `programs` are the parameter sets of both tightening controllers. Raises ConfigError, OSError (address in use).
    """
    stand = Stand()
    async with AsyncExitStack() as stack:
        await _drives(stack, stand, config, plant, faults)
        await _modbus(stack, stand, config, plant, faults, render)
        for name, gun in _of(config, GunEntry).items():
            _local(gun.host, f"devices.{name}.host")
            controller: SimulatedGun = pkgutil.resolve_name(gun.simulator)(name, gun, plant, faults, programs)
            stand.guns[name] = controller
            stack.push_async_callback(controller.close)
            await controller.start()
        streams, drops, cameras = _of(config, ForceLineEntry), _of(config, FileDropEntry), _of(config, GentlEntry)
        behind = fake_devices(config, plant, BehindWire(faults), render, (*streams, *drops, *cameras))
        for name, line in streams.items():
            amplifier = ForceAmplifier(behind[name], faults, _room_for(config.beside(line.path)))
            stand.forces[name] = amplifier
            stack.push_async_callback(amplifier.close)
            await amplifier.start()
        for name, drop in drops.items():
            folder = DropFolder(behind[name], faults, config.beside(drop.folder))
            stand.scanners[name] = folder
            stack.push_async_callback(folder.close)
            await folder.start()
        for name, camera in cameras.items():
            await _camera(stack, stand, SimulatedCamera(behind[name], faults), camera.producer)
        yield stand


async def _camera(stack: AsyncExitStack, stand: Stand, camera: SimulatedCamera, producer: str) -> None:
    at = urlsplit(producer)
    if at.scheme != "socket" or at.hostname is None or not at.port:
        raise ConfigError("a camera is simulated at socket://HOST:PORT only", place=f"devices.{camera.name}.producer")
    _local(at.hostname, f"devices.{camera.name}.producer")
    stand.scanners[camera.name] = camera
    stack.push_async_callback(camera.close)
    await camera.start(at.hostname, at.port)


async def _drives(stack: AsyncExitStack, stand: Stand, config: CellConfig, plant: Plant, faults: FaultBook) -> None:
    axes = _of(config, CanAxisEntry)
    if not axes:
        return
    assert config.can is not None, "the cell file was checked"
    channel = urlsplit(config.can.channel)
    if config.can.interface != "slcan" or channel.scheme != "socket" or channel.hostname is None or not channel.port:
        raise ConfigError("drives are simulated behind slcan at socket://HOST:PORT only", place="can.channel")
    _local(channel.hostname, "can.channel")
    stack.push_async_callback(stand.hub.close)
    await stand.hub.start(channel.hostname, channel.port)
    for name, entry in axes.items():
        node = CanNode(stand.hub, entry.node, name, plant, faults, scale=entry.counts_per_unit, feed=entry.feed)
        stand.nodes[name] = node
        stack.callback(node.close)


async def _modbus(
    stack: AsyncExitStack, stand: Stand, config: CellConfig, plant: Plant, faults: FaultBook, render: Render
) -> None:
    entries = _of(config, ModbusEntry)
    fakes = fake_devices(config, plant, faults, render, tuple(entries))
    servers: dict[_Server, dict[int, dict[int, Any]]] = {}
    framings: dict[_Server, Any] = {}
    for name, entry in entries.items():
        at = ("", 0, entry.port_path) if entry.port_path else (entry.host, entry.port, "")
        parts = servers.setdefault(at, {}).setdefault(entry.unit, {})
        if entry.base in parts:
            taken = parts[entry.base].name
            raise ConfigError(f"{taken} has unit {entry.unit} and base {entry.base} already", place=f"devices.{name}")
        parts[entry.base] = fakes[name]
        framings[at] = "rtu" if entry.port_path else entry.framing
    for at, units in servers.items():
        host, port, path = at
        simulated = SimulatedModbus(units, plant, faults, framings[at])
        stand.modbus.append(simulated)
        stack.push_async_callback(simulated.close)
        if path:
            link = _room_for(config.beside(path))
            link.unlink(missing_ok=True)
            link.symlink_to(await simulated.start_pty())
            stack.callback(link.unlink, missing_ok=True)
        else:
            _local(host, f"devices (Modbus at {host}:{port})")
            await simulated.start(port)


def _of(config: CellConfig, kind: type[Entry]) -> dict[str, Entry]:
    return {name: entry for name, entry in config.entries.items() if isinstance(entry, kind)}


def _local(host: str, place: str) -> None:
    with contextlib.suppress(ValueError):
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return
    raise ConfigError(f"{host} is not this machine: nothing is simulated there", place=place)


def _room_for(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
