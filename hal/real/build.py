"""All real devices of one cell, by their names in the cell file, with the adapters that they share."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hal.bus.camera import SOCKET
from hal.bus.can import CanBus
from hal.bus.ears import Link
from hal.bus.modbus import Lines
from hal.config import CellConfig
from hal.entries import (
    AXIS_UNITS,
    CanAxisEntry,
    FileDropEntry,
    ForceLineEntry,
    GentlEntry,
    GunEntry,
    ModbusEntry,
)
from hal.real.axes import CanAxis
from hal.real.force import SerialForceSensor
from hal.real.gentl import GentlScanner
from hal.real.modbus_devices import beside, modbus_device
from hal.real.scanner import FileDropScanner


@dataclass(frozen=True, slots=True)
class Guarded:
    """What is behind a guard process: the drives' bus, and by their names the devices that it owns."""

    link: Link
    devices: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RealDevices:
    """Not connected. The first device that is connected opens what it shares with others, the last one closes it.

    `can` is the adapter of the drives where it is this process' own: they stop unless its `beat` is called in time.
    """

    devices: Mapping[str, Any]
    can: CanBus | None


def real_devices(config: CellConfig, guarded: Guarded | None = None) -> RealDevices:
    """Every device of `config` that is not fake; `guarded` are those that a guard process owns. Must be called inside
    the running loop."""
    lines = Lines()
    can = CanBus(config.can.described, node=config.can.node) if config.can and guarded is None else None
    link = guarded.link if guarded else can
    devices: dict[str, Any] = {}
    for name, entry in config.entries.items():
        match entry:
            case _ if guarded and name in guarded.devices:
                devices[name] = guarded.devices[name]
            case CanAxisEntry():
                assert link is not None and config.can is not None, "the cell file was checked"
                devices[name] = CanAxis(name, AXIS_UNITS[name], entry, link, controller=config.can.node)
            case GunEntry():
                devices[name] = pkgutil.resolve_name(entry.backend)(name, entry)
            case ForceLineEntry():
                path = str(config.beside(entry.path))
                devices[name] = SerialForceSensor(name, entry.model_copy(update={"path": path}))
            case FileDropEntry():
                folder = config.beside(entry.folder)
                devices[name] = FileDropScanner(name, entry.model_copy(update={"folder": folder}))
            case GentlEntry():
                devices[name] = GentlScanner(name, _producer(config, entry))
            case ModbusEntry():
                devices[name] = modbus_device(name, beside(config, entry), lines)
    return RealDevices(devices, can)


def _producer(config: CellConfig, entry: GentlEntry) -> GentlEntry:
    """A producer's file is named relative to the cell file."""
    if entry.producer.startswith(SOCKET):
        return entry
    return entry.model_copy(update={"producer": str(config.beside(entry.producer))})
