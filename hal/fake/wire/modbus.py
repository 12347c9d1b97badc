"""Simulated Modbus devices of the cell, by their names in the cell file, each behind a server of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from hal.bus.modbus_server import ModbusServer
from hal.codec.modbus import Framing
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.wire.modbus_heat import HeaterPart, gap_probe, pyrometer, thermocouple
from hal.fake.wire.modbus_io import ChuckPart, EnablePart, FeederPart, ParkPart, SafetyPart, StationPart
from hal.fake.wire.modbus_units import Part, Unit, UnitsByNumber

PARTS: Mapping[str, Callable[[Any, FaultBook, Plant], Part]] = MappingProxyType(
    dict.fromkeys(("spigot_tc_1", "spigot_tc_2", "rotor_tc"), thermocouple)
    | dict.fromkeys(("gap_probe_1", "gap_probe_2", "gap_probe_3"), gap_probe)
    | {
        "pyrometer": pyrometer,
        "heater": HeaterPart,
        "chuck": ChuckPart,
        "camera_park": ParkPart,
        "nut_feeder": FeederPart,
        "tool_enable": EnablePart,
        "safety": SafetyPart,
        "part_station": StationPart,
    }
)
"""How a fake is put behind registers."""


class SimulatedModbus:
    """One server with units, `{unit: {base: fake}}`. `server` has the faults of the wire."""

    def __init__(
        self, fakes: Mapping[int, Mapping[int, Any]], plant: Plant, faults: FaultBook, framing: Framing = "tcp"
    ) -> None:
        units = {
            number: Unit({base: PARTS[fake.name](fake, faults, plant) for base, fake in parts.items()})
            for number, parts in fakes.items()
        }
        self._by_number = units
        self._units = UnitsByNumber(units, serial=framing == "rtu")
        self.server = ModbusServer(self._units, framing)

    async def start(self, port: int = 0) -> int:
        """Serve on a port of this machine, 0 for a free one; it is returned."""
        self.server.port = port or self.server.port
        await self.server.start()
        return self.server.port

    async def start_pty(self) -> str:
        """Serve RTU on a pseudo-terminal, whose path is returned."""
        await self.server.start_pty()
        return self.server.port_path

    def part(self, unit: int, base: int = 0) -> Part:
        """The registers of one device, to be tampered with."""
        return self._by_number[unit].parts[base]

    async def close(self) -> None:
        """Take everything down."""
        await self.server.close()
        await self._units.close()
