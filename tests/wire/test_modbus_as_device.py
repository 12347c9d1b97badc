"""What every device of the cell must do, by everything behind Modbus."""

from __future__ import annotations

import pytest

from tests.contract import wire_modbus
from tests.contract.backends import WireBackend
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase

TCP = WireBackend(wire_modbus.installed, speed=100.0)
RTU = WireBackend(wire_modbus.installed_rtu, "wire_rtu", speed=100.0)
NAMES = (
    "spigot_tc_1", "pyrometer", "heater", "chuck", "camera_park", "nut_feeder", "tool_enable", "gap_probe_1", "safety",
    "part_station",
)  # fmt: skip


@pytest.mark.parametrize("backend", [TCP, RTU], ids=["tcp", "rtu"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", (*CONNECTED, *UNANSWERED))
def test_it_is_a_device_like_any_other(case: DeviceCase, name: str, backend: WireBackend) -> None:
    case(backend, name)
