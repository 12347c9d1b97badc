"""One fake device by its name in the cell file."""

from __future__ import annotations

from typing import Any

from hal.fake.camera_park import FakeCameraPark
from hal.fake.faults import FaultBook
from hal.fake.io import FakeChuck, FakeGapProbe, FakeSafety
from hal.fake.plant import Plant
from hal.fake.supply import FakeNutFeeder, FakePartStation

DEVICES = (
    "chuck",
    "camera_park",
    "nut_feeder",
    "gap_probe_1",
    "gap_probe_2",
    "gap_probe_3",
    "safety",
    "part_station",
)


def fake_device(name: str, plant: Plant, faults: FaultBook) -> Any:
    match name:
        case "chuck":
            return FakeChuck(name, plant, faults)
        case "camera_park":
            return FakeCameraPark(name, plant, faults)
        case "nut_feeder":
            return FakeNutFeeder(name, plant, faults)
        case "gap_probe_1" | "gap_probe_2" | "gap_probe_3":
            return FakeGapProbe(name, plant, faults)
        case "safety":
            return FakeSafety(name, plant, faults)
        case "part_station":
            return FakePartStation(name, plant, faults)
    raise AssertionError(name)
