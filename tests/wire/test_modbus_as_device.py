"""What every device of the cell must do, by everything behind Modbus."""

from __future__ import annotations

import pytest

from tests.contract import wire_modbus
from tests.contract.backends import WireBackend
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase

TCP = WireBackend(wire_modbus.installed, speed=100.0)
RTU = WireBackend(wire_modbus.installed_rtu, "wire_rtu", speed=100.0)
PAIRS = [(name, TCP) for name in (
    "spigot_tc_1", "pyrometer", "heater", "chuck", "camera_park", "nut_feeder", "tool_enable", "gap_probe_1", "safety",
    "part_station",
)] + [(name, RTU) for name in ("spigot_tc_1", "pyrometer", "heater")]  # fmt: skip


@pytest.mark.parametrize(("name", "backend"), PAIRS)
@pytest.mark.parametrize("case", (*CONNECTED, *UNANSWERED))
def test_it_is_a_device_like_any_other(case: DeviceCase, name: str, backend: WireBackend) -> None:
    case(backend, name)
