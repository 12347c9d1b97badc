"""Joints, twins and calibrations of a calibration campaign: each number draws a case of its own.

What a case believes of its cell is of the strength that its twin was drawn with, so that a true uncertainty is within
reach; what exactly the twin's errors are, nobody told the controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from cellctl.calibration import Calibration, load_calibration
from cellctl.recipe import PartSpec, Recipe, load_recipe
from cellctl.twin import geometry_of
from hal.fake.levels import imperfections
from hal.fake.plant import Plant, TwinSettings
from tests.docking.parts import ROOT

SYSTEMATIC = (
    "view_rotation_deg",
    "view_translation_mm",
    "jack_direction_deg",
    "jack_straightness_mm",
    "jack_roll_deg",
    "table_encoder_deg",
    "table_runout_mm",
    "axis_backlash_mm",
    "axis_scale",
    "scanner_ripple_mm",
    "scanner_scale",
)
"""Imperfections that no residual shows; all of them are redrawn with each twin."""
SERIALS = ("R-1", "S-1")
BORE_MM = 145.0
"""The twin's rotor has a bore of its own; faces stay outside."""


@dataclass(frozen=True, slots=True)
class Case:
    """One joint on one twin, and what is believed of that cell."""

    recipe: Recipe
    calibration: Calibration
    seed: int
    overrides: Mapping[str, float]

    def plant(self) -> Plant:
        """The twin with its parts, everything at home."""
        plant = Plant(geometry_of(self.recipe), TwinSettings(self.seed, "nominal", self.overrides))
        plant.load_parts(*SERIALS)
        return plant


def case(
    seed: int, recipe: Recipe, *, systematic: float = 1.0, feature_scale: float = 1.0, correlation_px: float = 3.0
) -> Case:
    """The case of one seed: systematic errors so many times nominal, parts and scanner noise likewise."""
    nominal = imperfections("nominal")
    overrides = {name: systematic * getattr(nominal, name) for name in SYSTEMATIC}
    overrides["scanner_correlation_px"] = correlation_px
    for name in ("feature_position_mm", "scanner_noise_mm"):
        overrides[name] = feature_scale * getattr(nominal, name)
    limits = recipe.limits.model_copy(update={"position_sigma_mm": overrides["feature_position_mm"]})
    return Case(recipe.model_copy(update={"limits": limits}), calibration_of(systematic), seed, overrides)


def calibration_of(scale: float) -> Calibration:
    """The fake cell's calibration with every uncertainty so many times as large."""
    found = _calibration()

    def section(name: str) -> dict[str, object]:
        values = getattr(found, name)
        sigmas = {key: scale * getattr(values, key) for key in type(values).model_fields if key.startswith("sigma_")}
        return {name: values.model_copy(update=sigmas)}

    views = {
        name: view.model_copy(
            update={
                "sigma_rotation_deg": scale * view.sigma_rotation_deg,
                "sigma_translation_mm": scale * view.sigma_translation_mm,
            }
        )
        for name, view in found.views.items()
    }
    lines = section("table_axis") | section("jack_line") | section("stage") | section("scanner")
    return found.model_copy(update={"views": views} | lines)


def default_recipe() -> Recipe:
    """The worked example: 36 studs M8x1 on 240 mm."""
    return _recipe()


def with_clearance(recipe: Recipe, radial_mm: float) -> Recipe:
    """The recipe with holes that leave that radial clearance."""
    rotor, shaft = _part(recipe.rotor), _part(recipe.shaft)
    assert rotor.thread is not None
    hole_mm = rotor.thread.major_diameter_mm + 2.0 * radial_mm
    chamfer_mm = hole_mm + 1.6
    return recipe.model_copy(
        update={
            "shaft": shaft.model_copy(update={"diameter_mm": hole_mm, "chamfer_diameter_mm": chamfer_mm}),
            "limits": recipe.limits.model_copy(update={"radial_clearance_mm": radial_mm}),
        }
    )


def random_recipe(seed: int) -> Recipe:
    """A joint of another size: count, circle, thread, length and depth drawn, angles equal or not."""
    draw = np.random.default_rng([seed, 1])
    whole = _recipe()
    rotor, shaft = _part(whole.rotor), _part(whole.shaft)
    assert rotor.thread is not None
    major = float(draw.uniform(6.0, 12.0))
    width = 2.2 * major + 6.0
    circle = float(draw.uniform(BORE_MM + width, 250.0))
    most = int(np.pi * circle / (2.2 * major))
    count = int(draw.integers(6, min(most, 48) + 1))
    angles = 360.0 * np.arange(count) / count
    if draw.random() < 0.5:
        angles = angles + draw.uniform(-0.15, 0.15, count) * 360.0 / count
    thread = rotor.thread.model_copy(
        update={"major_diameter_mm": major, "pitch_mm": round(float(draw.uniform(0.1, 0.16)) * major, 3)}
    )
    faces = {
        "face_inner_diameter_mm": circle - width,
        "face_outer_diameter_mm": circle + width,
        "spigot_diameter_mm": circle - width,
    }
    length = float(draw.uniform(2.5, 4.0)) * major
    drawn = whole.model_copy(
        update={
            "pattern": whole.pattern.model_copy(
                update={"count": count, "circle_diameter_mm": circle, "angles_deg": tuple(float(a) for a in angles)}
            ),
            "rotor": rotor.model_copy(
                update=faces | {"thread": thread, "diameter_mm": major, "length_mm": min(length, 34.0)}
            ),
            "shaft": shaft.model_copy(update=faces | {"depth_mm": float(draw.uniform(1.2, 2.0)) * major}),
        }
    )
    return with_clearance(drawn, 0.15)


def _part(spec: PartSpec | None) -> PartSpec:
    assert spec is not None
    return spec


@cache
def _recipe() -> Recipe:
    return load_recipe(ROOT / "recipes" / "lpt_shaft_36.toml")


@cache
def _calibration() -> Calibration:
    return load_calibration(ROOT / "deploy" / "calibration.fake.toml")
