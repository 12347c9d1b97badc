"""All fakes of one cell, by their names in the cell file, on one plant."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

from hal.config import CellConfig
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
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.interfaces import AxisLimits

AXIS_UNITS: Mapping[str, Literal["mm", "deg"]] = MappingProxyType(
    {"stage_x": "mm", "stage_y": "mm", "jack": "mm", "shaft_table": "deg", "gun_table": "deg", "gun_feed": "mm"}
)


def fake_devices(config: CellConfig, plant: Plant, faults: FaultBook, render: Render) -> dict[str, Any]:
    """Every device of `config`, not connected. `render` computes the scanner's clouds."""
    entries = config.devices

    def axis(name: str, unit: Literal["mm", "deg"]) -> FakeAxis:
        entry = getattr(entries, name)
        limits = AxisLimits(entry.low, entry.high, entry.max_speed, entry.max_acceleration)
        return FakeAxis(name, unit, limits, plant, faults)

    force, force_a, force_b = entries.jack_force, entries.gun_force_a, entries.gun_force_b
    return {
        **{name: axis(name, unit) for name, unit in AXIS_UNITS.items()},
        **{name: FakeGun(name, plant, faults) for name in ("gun_a", "gun_b")},
        "jack_force": FakeForceSensor("jack_force", plant, faults, rate_hz=force.rate_hz, range_n=force.range_n),
        "gun_force_a": FakeGunForce("gun_force_a", plant, faults, force_a.rate_hz, force_a.range_n),
        "gun_force_b": FakeGunForce("gun_force_b", plant, faults, force_b.rate_hz, force_b.range_n),
        **{
            name: FakeThermometer(name, plant, faults)
            for name in ("spigot_tc_1", "spigot_tc_2", "pyrometer", "rotor_tc")
        },
        "heater": FakeHeater("heater", plant, faults, entries.heater.max_power_w),
        "chuck": FakeChuck("chuck", plant, faults),
        "camera_park": FakeCameraPark("camera_park", plant, faults),
        "nut_feeder": FakeNutFeeder("nut_feeder", plant, faults),
        **{name: FakeGapProbe(name, plant, faults) for name in ("gap_probe_1", "gap_probe_2", "gap_probe_3")},
        "safety": FakeSafety("safety", plant, faults),
        "part_station": FakePartStation("part_station", plant, faults),
        "scanner": FakeScanner(plant, faults, render, points=config.twin.points),
    }
