"""A plant to test on: small joints, the shaft brought to its best pose by the plant's own axes."""

from __future__ import annotations

from collections.abc import Mapping

from hal.fake.contact.engagement import present_error
from hal.fake.geometry import JointGeometry
from hal.fake.levels import Level
from hal.fake.plant import Plant, TwinSettings


def equal_joint(count: int = 36) -> JointGeometry:
    """The 36-stud joint, or one like it."""
    return JointGeometry(tuple(360.0 * i / count for i in range(count)))


def plant_of(
    level: Level = "nominal", *, seed: int = 1, count: int = 36, overrides: Mapping[str, float] | None = None
) -> Plant:
    return Plant(equal_joint(count), TwinSettings(seed, level, overrides or {}))


def go(plant: Plant, axis: str, target: float, *, speed: float = 10.0, acceleration: float = 50.0) -> None:
    """Move one axis to its end, a tenth of a second of rest included."""
    end_s = plant.start_move(axis, target, speed=speed, acceleration=acceleration, now=plant.now).end_s
    plant.advance(end_s + 0.1)


def align(plant: Plant, *, x_mm: float = 0.0, y_mm: float = 0.0, theta_deg: float = 0.0) -> None:
    """Bring the shaft to its best pose plus an error."""
    for _ in range(3):
        error, at = present_error(plant.dock()), plant.motors()
        go(plant, "stage_x", at.x_mm - error.x_mm)
        go(plant, "stage_y", at.y_mm - error.y_mm)
        go(plant, "shaft_table", at.theta_deg - error.theta_deg)
    at = plant.motors()
    go(plant, "stage_x", at.x_mm + x_mm)
    go(plant, "stage_y", at.y_mm + y_mm)
    go(plant, "shaft_table", at.theta_deg + theta_deg)
