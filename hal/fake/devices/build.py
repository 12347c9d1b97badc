"""All fakes of one cell, by their names in the cell file, on one plant."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Literal

from hal.config import CellConfig
from hal.entries import AXIS_UNITS, Devices
from hal.fake.devices.axes import FakeAxis
from hal.fake.devices.camera_park import FakeCameraPark
from hal.fake.devices.chuck import FakeChuck
from hal.fake.devices.force import FakeForceSensor
from hal.fake.devices.gun_force import FakeGunForce
from hal.fake.devices.guns import FakeGun
from hal.fake.devices.heating import FakeHeater, FakeThermometer
from hal.fake.devices.io import FakeGapProbe, FakeSafety
from hal.fake.devices.scanner import FakeScanner, Render
from hal.fake.devices.supply import FakeNutFeeder, FakePartStation
from hal.fake.devices.tool_enable import FakeToolEnable
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.interfaces import AxisLimits


def fake_devices(
    config: CellConfig,
    plant: Plant,
    faults: FaultBook,
    render: Render,
    names: Collection[str] = tuple(Devices.model_fields),
) -> dict[str, Any]:
    """The devices of `config` that `names` says, not connected, whatever their kind there. `render` computes the
    scanner's clouds."""
    entries = config.devices

    def axis(name: str, unit: Literal["mm", "deg"]) -> FakeAxis:
        entry = getattr(entries, name)
        limits = AxisLimits(entry.low, entry.high, entry.max_speed, entry.max_acceleration)
        return FakeAxis(name, unit, limits, plant, faults)

    def gun_force(name: str) -> FakeGunForce:
        entry = getattr(entries, name)
        return FakeGunForce(name, plant, faults, entry.rate_hz, entry.range_n)

    def jack_force(name: str) -> FakeForceSensor:
        entry = entries.jack_force
        return FakeForceSensor(name, plant, faults, rate_hz=entry.rate_hz, range_n=entry.range_n)

    makers: dict[str, Callable[[str], Any]] = {
        **dict.fromkeys(AXIS_UNITS, lambda name: axis(name, AXIS_UNITS[name])),
        **dict.fromkeys(("gun_a", "gun_b"), lambda name: FakeGun(name, plant, faults)),
        "jack_force": jack_force,
        **dict.fromkeys(("gun_force_a", "gun_force_b"), gun_force),
        **dict.fromkeys(
            ("spigot_tc_1", "spigot_tc_2", "pyrometer", "rotor_tc"), lambda name: FakeThermometer(name, plant, faults)
        ),
        "heater": lambda name: FakeHeater(name, plant, faults, entries.heater.max_power_w),
        "chuck": lambda name: FakeChuck(name, plant, faults),
        "camera_park": lambda name: FakeCameraPark(name, plant, faults),
        "nut_feeder": lambda name: FakeNutFeeder(name, plant, faults),
        "tool_enable": lambda name: FakeToolEnable(name, plant, faults),
        **dict.fromkeys(("gap_probe_1", "gap_probe_2", "gap_probe_3"), lambda name: FakeGapProbe(name, plant, faults)),
        "safety": lambda name: FakeSafety(name, plant, faults),
        "part_station": lambda name: FakePartStation(name, plant, faults),
        "scanner": lambda name: FakeScanner(plant, faults, render, points=config.twin.points, name=name),
    }
    return {name: make(name) for name, make in makers.items() if name in names}
