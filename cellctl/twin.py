"""The cell of a cell file with the twin behind its fakes: a plant made from recipe and cell file.

Used by the composition roots only.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.recipe import PartSpec, Recipe
from hal.cell import Behind, Cell, build_cell
from hal.config import CellConfig
from hal.errors import ConfigError
from hal.fake.devices.guns import install_joints
from hal.fake.devices.heating import install_heat
from hal.fake.fault_file import Fault
from hal.fake.faults import FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.plant import Plant, TwinSettings
from hal.fake.scene.render import SceneState, render
from hal.fake.truth import TruthLimits
from hal.jobs import Jobs

RENDERING = ("hal.fake.scene.render",)
"""What a worker process imports that computes clouds."""


@dataclass(frozen=True, slots=True)
class FakeCell:
    """A cell on fake devices, not connected, with the plant and the faults behind it."""

    cell: Cell
    plant: Plant
    faults: FaultBook


@dataclass(frozen=True, slots=True)
class StandingCell:
    """A cell, not connected. `behind` is what its fakes stand on, None where nothing is fake."""

    cell: Cell
    behind: Behind | None

    def enter_phase(self, name: str) -> None:
        """The run enters a phase: planted faults begin."""
        if self.behind is not None:
            self.behind.faults.enter_phase(name, asyncio.get_running_loop().time())

    def carries(self, recipe: Recipe) -> bool:
        """Whether the parts of `recipe` can come into this cell as it is: a twin is built for one joint."""
        return self.behind is None or self.behind.plant.geometry == geometry_of(recipe)


def standing_cell(
    recipe: Recipe, config: CellConfig, jobs: Jobs, *, seed: int, faults: Iterable[Fault] = ()
) -> StandingCell:
    """The cell of `config`; its fakes, where it has any, on a twin for `recipe`. Raises ConfigError."""
    if "fake" not in config.kinds.values():
        if planted := sorted({fault.device for fault in faults}):
            raise ConfigError(f"faults are planted in fakes only, not in {', '.join(planted)}", place="faults")
        return StandingCell(build_cell(config), None)
    twin = twin_of(recipe, config, jobs, seed=seed, faults=faults)
    return StandingCell(build_cell(config, twin), twin)


def fake_cell(recipe: Recipe, config: CellConfig, jobs: Jobs, *, seed: int, faults: Iterable[Fault] = ()) -> FakeCell:
    """Plant, faults, and a cell all of whose devices are fake. Clouds are rendered by `jobs`. Raises ConfigError."""
    twin = twin_of(recipe, config, jobs, seed=seed, faults=faults)
    return FakeCell(build_cell(config.on_fakes(), twin), twin.plant, twin.faults)


def twin_of(
    recipe: Recipe, config: CellConfig, jobs: Jobs, *, seed: int, faults: Iterable[Fault] = (), now: float = 0.0
) -> Behind:
    """A plant for `recipe` as `[twin]` says, from loop time `now` on. Clouds are rendered by `jobs`."""
    plant = Plant(geometry_of(recipe), TwinSettings(seed, config.twin.level, config.twin.overrides), now=now)
    install_heat(plant)
    install_joints(plant, nuts_by_hand=recipe.tighten.nut_supply == "hand_started")

    async def picture(scene: SceneState, picture_seed: int) -> NDArray[np.float32]:
        return await jobs.run(render, scene, picture_seed, latency_s=0.0)

    return Behind(plant, FaultBook(faults), picture)


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
        spigot_length_mm=recipe.heat.spigot_depth_mm,
        interference_mm=recipe.heat.fit_interference_mm,
        heated_member=recipe.heat.member,
        expansion_per_k=recipe.heat.expansion_per_k,
        shaft_mass_kg=recipe.limits.shaft_mass_kg,
    )


def truth_limits(recipe: Recipe) -> TruthLimits:
    """What makes a joint of `recipe` good: its own limits of gap and preload, its force per stud."""
    limits = recipe.limits
    return TruthLimits(
        force_per_bolt_n=recipe.jack_up.force_limit_n,
        gap_mm=limits.gap_mm,
        preload_low_n=limits.preload_low_n,
        preload_high_n=limits.preload_high_n,
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
