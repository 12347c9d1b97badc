"""The Modbus device of each name in the cell file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from hal.bus.modbus import Lines
from hal.config import CellConfig
from hal.entries import ModbusEntry
from hal.real.io import CameraPark, Chuck, NutFeeder, SafetyInputs
from hal.real.measuring import GapProbe
from hal.real.station import PartStation
from hal.real.thermal import Heater, Pyrometer, Thermocouple
from hal.real.tool_enable import ToolEnable

_DEVICES: Mapping[str, Callable[[str, Any, Lines], Any]] = MappingProxyType(
    dict.fromkeys(("spigot_tc_1", "spigot_tc_2", "rotor_tc"), Thermocouple)
    | dict.fromkeys(("gap_probe_1", "gap_probe_2", "gap_probe_3"), GapProbe)
    | {
        "pyrometer": Pyrometer,
        "heater": Heater,
        "chuck": Chuck,
        "camera_park": CameraPark,
        "nut_feeder": NutFeeder,
        "tool_enable": ToolEnable,
        "safety": SafetyInputs,
        "part_station": PartStation,
    }
)


def modbus_device(name: str, entry: ModbusEntry, lines: Lines) -> Any:
    """The device `name` as its entry says, not connected; devices with the same link share a line of `lines`."""
    return _DEVICES[name](name, entry, lines)


def beside(config: CellConfig, entry: ModbusEntry) -> ModbusEntry:
    """`entry` with its serial port, which is named relative to the cell file."""
    return entry.model_copy(update={"port_path": str(config.beside(entry.port_path))}) if entry.port_path else entry
