"""The Modbus device of each name in the cell file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from hal.bus.modbus import Lines
from hal.entries import ModbusEntry
from hal.real.io import CameraPark, Chuck, NutFeeder, SafetyInputs
from hal.real.measuring import GapProbe
from hal.real.station import PartStation
from hal.real.thermal import Heater, Pyrometer, Thermocouple

_DEVICES: Mapping[str, Callable[[str, Any, Lines], Any]] = MappingProxyType(
    dict.fromkeys(("spigot_tc_1", "spigot_tc_2", "rotor_tc"), Thermocouple)
    | dict.fromkeys(("gap_probe_1", "gap_probe_2", "gap_probe_3"), GapProbe)
    | {
        "pyrometer": Pyrometer,
        "heater": Heater,
        "chuck": Chuck,
        "camera_park": CameraPark,
        "nut_feeder": NutFeeder,
        "safety": SafetyInputs,
        "part_station": PartStation,
    }
)


def modbus_device(name: str, entry: ModbusEntry, lines: Lines) -> Any:
    """The device `name` as its entry says, not connected; devices with the same link share a line of `lines`."""
    return _DEVICES[name](name, entry, lines)
