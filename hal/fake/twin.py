"""The whole twin of one bench: geometry and mechanics with heat, heater controller, nuts and guns."""

from __future__ import annotations

from hal.fake.geometry import BenchGeometry, JointGeometry
from hal.fake.guns import install_joints
from hal.fake.heating import install_heat
from hal.fake.plant import Plant, TwinSettings


def build_twin(
    geometry: JointGeometry,
    settings: TwinSettings,
    bench: BenchGeometry | None = None,
    *,
    nuts_by_hand: bool = False,
    now: float = 0.0,
) -> Plant:
    """A plant with everything that fakes stand on. Raises ConfigError where an override is unknown.

    `nuts_by_hand`: an operator starts the nuts; otherwise they come from the magazine.
    """
    plant = Plant(geometry, settings, bench, now)
    install_heat(plant)
    install_joints(plant, nuts_by_hand=nuts_by_hand)
    return plant
