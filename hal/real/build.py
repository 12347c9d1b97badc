"""All real devices of one cell, by their names in the cell file, with the adapters that they share."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hal.bus.camera import SOCKET
from hal.bus.can import CanBus
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
from hal.real.modbus_devices import modbus_device
from hal.real.scanner import FileDropScanner


@dataclass(frozen=True, slots=True)
class RealDevices:
    """Not connected. The first device that is connected opens what it shares with others, the last one closes it.

    `can` is the adapter of the drives, None where the cell has none: they stop unless its `beat` is called in time.
    """

    devices: Mapping[str, Any]
    can: CanBus | None


def real_devices(config: CellConfig) -> RealDevices:
    """Every device of `config` that is not fake. Must be called inside the running loop."""
    lines, can = Lines(), can_bus(config)
    devices: dict[str, Any] = {}
    for name, entry in config.entries.items():
        match entry:
            case CanAxisEntry():
                assert can is not None, "the cell file was checked"
                devices[name] = CanAxis(name, AXIS_UNITS[name], entry, can, controller=can.node)
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
                devices[name] = modbus_device(name, _beside(config, entry), lines)
    return RealDevices(devices, can)


def can_bus(config: CellConfig) -> CanBus | None:
    """The adapter of `[can]`, not open."""
    entry = config.can
    if entry is None:
        return None
    options = {"interface": entry.interface, "channel": entry.channel, "bitrate": entry.bitrate, **entry.options}
    return CanBus(options, node=entry.node)


def _beside(config: CellConfig, entry: ModbusEntry) -> ModbusEntry:
    """A serial port is named relative to the cell file."""
    return entry.model_copy(update={"port_path": str(config.beside(entry.port_path))}) if entry.port_path else entry


def _producer(config: CellConfig, entry: GentlEntry) -> GentlEntry:
    """A producer's file is named relative to the cell file."""
    if entry.producer.startswith(SOCKET):
        return entry
    return entry.model_copy(update={"producer": str(config.beside(entry.producer))})
