"""What every device of the cell must do, by the Kolver gun over the wire."""

from __future__ import annotations

import pytest

from tests.contract import wire_kducer
from tests.contract.backends import WireBackend
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase

WIRE = WireBackend(wire_kducer.installed, speed=200.0)


@pytest.mark.parametrize("name", ["gun_a", "gun_b"])
@pytest.mark.parametrize("case", (*CONNECTED, *UNANSWERED))
def test_it_is_a_device_like_any_other(case: DeviceCase, name: str) -> None:
    case(WIRE, name)
