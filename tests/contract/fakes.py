"""The fakes of the example cell, by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.config import load_cell
from hal.entries import Devices
from hal.fake.devices.build import fake_devices
from hal.fake.devices.guns import install_joints
from hal.fake.devices.heating import install_heat
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.scene.render import SceneState

DEVICES = tuple(Devices.model_fields)
CELL = load_cell(Path(__file__).parents[2] / "deploy" / "cell.fake.toml")


async def _render(scene: SceneState, seed: int) -> NDArray[np.float32]:
    """A cloud that tells its seed; what a true picture shows is not the contract's matter."""
    return np.full((4, 6, 3), float(seed % 1000), dtype=np.float32)


def fake_device(name: str, plant: Plant, faults: FaultBook) -> Any:
    """One device; the plant gets its heat and its nuts."""
    install_heat(plant)
    install_joints(plant)
    return fake_devices(CELL, plant, faults, _render)[name]
