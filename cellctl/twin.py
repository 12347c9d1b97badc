"""The plant that stands behind fake devices, made from a recipe and the cell file. Used by composition roots only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cellctl.recipe import PartSpec, Recipe
from hal.config import Level
from hal.errors import ConfigError
from hal.fake.geometry import JointGeometry


@dataclass(frozen=True, slots=True)
class TwinRequest:
    """Which twin: seed, level and named overrides, as in the cell file's `[twin]`."""

    seed: int
    level: Level = "nominal"
    overrides: Mapping[str, float] = field(default_factory=dict)


def geometry_of(recipe: Recipe) -> JointGeometry:
    """The drawing that the twin is built to: the recipe's nominal sizes. Raises ConfigError where one is missing."""
    shaft, rotor = _part(recipe, "shaft"), _part(recipe, "rotor")
    thread = rotor.thread
    if thread is None:
        raise ConfigError("the twin needs the studs' thread", place="rotor.thread")
    return JointGeometry(
        angles_deg=recipe.pattern.angles(),
        circle_diameter_mm=recipe.pattern.circle_diameter_mm,
        index_feature=recipe.pattern.index_feature,
        hole_diameter_mm=_size(shaft, "shaft", "diameter_mm"),
        hole_chamfer_diameter_mm=_size(shaft, "shaft", "chamfer_diameter_mm"),
        hole_chamfer_half_angle_deg=_size(shaft, "shaft", "chamfer_angle_deg"),
        hole_depth_mm=_size(shaft, "shaft", "depth_mm"),
        stud_diameter_mm=thread.major_diameter_mm,
        stud_length_mm=_size(rotor, "rotor", "length_mm"),
        thread_pitch_mm=thread.pitch_mm,
        thread_hand=thread.hand,
        thread_starts=thread.starts,
        face_inner_diameter_mm=_size(shaft, "shaft", "face_inner_diameter_mm"),
        face_outer_diameter_mm=_size(shaft, "shaft", "face_outer_diameter_mm"),
        ledge_step_mm=_size(shaft, "shaft", "ledge_step_mm"),
        spigot_diameter_mm=_size(shaft, "shaft", "spigot_diameter_mm"),
        interference_mm=recipe.heat.fit_interference_mm,
        heated_member=recipe.heat.member,
        expansion_per_k=recipe.heat.expansion_per_k,
        shaft_mass_kg=recipe.limits.shaft_mass_kg,
    )


def _part(recipe: Recipe, side: str) -> PartSpec:
    spec: PartSpec | None = getattr(recipe, side)
    if spec is None:
        raise ConfigError("an assembly needs both parts", place=side)
    return spec


def _size(part: PartSpec, side: str, name: str) -> float:
    value = getattr(part, name)
    if not isinstance(value, float | int):
        raise ConfigError("the twin needs this size as one number", place=f"{side}.{name}")
    return float(value)
