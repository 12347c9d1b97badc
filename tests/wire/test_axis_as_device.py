"""What every device of the cell must do, by a drive on CAN, its adapter here or behind the guard."""

from __future__ import annotations

import pytest

from tests.contract import wire_axis, wire_guard
from tests.contract.backends import WireBackend
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase

OWN = WireBackend(wire_axis.installed)
GUARDED = WireBackend(wire_guard.installed_axis, "wire_guard")


@pytest.mark.parametrize("backend", [OWN, GUARDED], ids=["own", "guarded"])
@pytest.mark.parametrize("case", (*CONNECTED, *UNANSWERED))
def test_it_is_a_device_like_any_other(case: DeviceCase, backend: WireBackend) -> None:
    case(backend, "jack")
