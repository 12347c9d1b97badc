"""The recipe: every process number of an assembly, versioned, with its unit. TOML in, frozen model out.

Page of the contract: `[recipe] [pattern] [shaft] [rotor] [scan] [align] [jack_up] [heat] [tighten] [limits]`.
`measure` needs only `[recipe]`, `[pattern]` and one part; a whole assembly needs all. Physics checks live in
`cellctl.recipe_checks`.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellctl.file_faults import parsed, read_toml
from cellctl.vision.part import Part, Thread
from hal.errors import ConfigError
from hal.units import (
    Celsius,
    Deg,
    Fraction,
    Kelvin,
    KelvinPerMinute,
    Kilogram,
    Mm,
    MmPerSecond,
    Newton,
    NewtonMetre,
    NewtonPerMm,
    PerKelvin,
    Rpm,
    Seconds,
    Watt,
)

Size = Annotated[Mm, Field(gt=0, le=5000)]
"""A length on a part."""


class Section(BaseModel):
    """A table of the recipe: frozen, unknown keys refused, no silent conversion of types."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Header(Section):
    """`[recipe]`: identity."""

    id: str = Field(pattern=r"^[a-z0-9][a-z0-9_\-]{0,63}$")
    version: int = Field(ge=1)
    title: str = Field(max_length=200)


class Pattern(Section):
    """`[pattern]`: the bolt pattern that both parts share."""

    count: int = Field(ge=3, le=120)
    circle_diameter_mm: Mm = Field(gt=0, le=2000)
    angles_deg: Literal["equal"] | tuple[Deg, ...] = "equal"
    index_feature: int | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _whole(self) -> Pattern:
        if len(self.angles()) != self.count:
            raise ValueError(f"angles_deg has {len(self.angles())} entries, count is {self.count}")
        if self.index_feature is not None and self.index_feature >= self.count:
            raise ValueError(f"index_feature must be below {self.count}")
        return self

    def angles(self) -> tuple[float, ...]:
        """Nominal angles of the features in degrees, right-handed about the outward normal of the shaft's face."""
        if self.angles_deg == "equal":
            return tuple(360.0 * i / self.count for i in range(self.count))
        return self.angles_deg


class ThreadSpec(Section):
    """Thread of the studs."""

    major_diameter_mm: Mm = Field(gt=0)
    pitch_mm: Mm = Field(gt=0)
    hand: Literal["right", "left"] = "right"
    starts: int = Field(default=1, ge=1, le=8)


class PartSpec(Section):
    """`[shaft]` or `[rotor]`: one side of the joint. Sizes that are not given are estimated or not used."""

    feature: Literal["hole", "stud"]
    diameter_mm: Size | tuple[Size, ...] | None = None
    chamfer_diameter_mm: Size | None = None
    chamfer_angle_deg: Deg | None = Field(default=None, gt=0, lt=90)
    depth_mm: Size | None = None
    length_mm: Size | None = None
    thread: ThreadSpec | None = None
    face_inner_diameter_mm: Size | None = None
    face_outer_diameter_mm: Size | None = None
    ledge_step_mm: Mm | None = None
    flatness_limit_mm: Size | None = None
    spigot_diameter_mm: Size | None = None


class Scan(Section):
    """`[scan]`: quality gates of a scan."""

    distance_low_mm: Mm = Field(default=300.0, gt=0)
    distance_high_mm: Mm = Field(default=400.0, gt=0)
    min_coverage: Fraction = Field(default=0.6, ge=0, le=1)
    min_points_per_feature: int = Field(default=60, ge=4)
    max_retakes: int = Field(default=2, ge=0, le=10)
    outlier_removal: Literal["none", "one_sided", "two_sided"] = "none"
    artefact_gate_mm: Mm = Field(default=0.1, gt=0)


class Align(Section):
    """`[align]`: gates and bounded tries of the closed loop."""

    gate_xy_mm: Mm = Field(default=0.05, gt=0)
    gate_theta_deg: Deg = Field(default=0.03, gt=0)
    gate_tilt_deg: Deg = Field(default=0.1, gt=0)
    motion_gate_mm: Mm = Field(default=0.3, gt=0)
    coverage_factor: Fraction = Field(default=2.0, gt=0)
    min_p_insert: Fraction = Field(default=0.99, ge=0, le=1)
    max_loops: int = Field(default=3, ge=1, le=10)
    expires_s: Seconds = Field(default=900.0, gt=0)
    stand_off_mm: Mm = Field(default=3.0, gt=0)


class JackUp(Section):
    """`[jack_up]`: guarded insertion of the studs up to the spigot."""

    approach_speed_mm_s: MmPerSecond = Field(default=10.0, gt=0)
    approach_force_limit_n: Newton = Field(default=50.0, gt=0)
    contact_speed_mm_s: MmPerSecond = Field(default=0.2, gt=0)
    force_limit_n: Newton = Field(default=10.0, gt=0)
    force_basis: Literal["per_bolt", "bounded_by_total"] = "bounded_by_total"
    tare_seconds_s: Seconds = Field(default=1.0, gt=0)
    weight_tolerance: Fraction = Field(default=0.05, gt=0)
    back_off_mm: Mm = Field(default=5.0, gt=0)
    max_tries: int = Field(default=2, ge=1, le=5)
    spigot_gap_mm: Mm = Field(default=4.0, gt=0)


class Heat(Section):
    """`[heat]`: warming of one member, proof of its temperature, seating inside the window.

    With `enabled = false` the joint is seated cold, which validation refuses for an interference fit unless the nuts
    may draw it in.
    """

    enabled: bool = True
    member: Literal["shaft", "rotor"] = "shaft"
    fit_interference_mm: Mm = Field(default=0.06, ge=0)
    fit_tolerance_mm: Mm = Field(default=0.005, ge=0)
    expansion_per_k: PerKelvin = Field(default=12.5e-6, gt=0)
    clearance_sigmas: Fraction = Field(default=3.0, ge=0, description="what the worst stud keeps at T_max")
    open_by_mm: Mm = Field(default=0.02, ge=0)
    difference_k: Kelvin = Field(default=45.0, gt=0)
    difference_tolerance_k: Kelvin = Field(default=3.0, gt=0)
    ramp_k_per_min: KelvinPerMinute = Field(default=10.0, gt=0)
    soak_s: Seconds = Field(default=60.0, ge=0)
    max_spread_k: Kelvin = Field(default=4.0, gt=0)
    channel_gate_k: Kelvin = Field(default=8.0, gt=0)
    pyrometer_gate_k: Kelvin = Field(default=12.0, gt=0)
    max_temperature_c: Celsius = 120.0
    max_power_w: Watt = Field(default=3000.0, gt=0)
    loop_break_s: Seconds = Field(default=90.0, gt=0)
    loop_break_rise_k: Kelvin = Field(default=2.0, gt=0)
    timeout_s: Seconds = Field(default=1800.0, gt=0)
    spigot_depth_mm: Mm = Field(default=3.0, gt=0, description="gap of the faces at which the spigot engages")
    seat_speed_mm_s: MmPerSecond = Field(default=1.0, gt=0)
    seat_window_s: Seconds = Field(default=8.0, gt=0)
    seat_force_limit_n: Newton = Field(default=400.0, gt=0)
    hold_force_n: Newton = Field(default=200.0, gt=0)
    seat_step_mm: Mm = Field(default=0.05, gt=0)
    seat_travel_mm: Mm = Field(default=0.5, gt=0)
    draw_in: bool = False


class Stage(Section):
    """One pass over all joints."""

    name: str
    torque_nm: NewtonMetre = Field(gt=0)
    torque_tolerance: Fraction = Field(default=0.05, gt=0, lt=1)
    angle_low_deg: Deg = Field(default=0.0, ge=0)
    angle_high_deg: Deg = Field(default=720.0, gt=0)
    speed_rpm: Rpm = Field(default=20.0, gt=0)
    cold: bool = False


class Engage(Section):
    """Socket engagement: slow feed, slow turn, force window. Feeds are positions of the gun feed axis."""

    feed_speed_mm_s: MmPerSecond = Field(default=2.0, gt=0)
    nut_from_mm: Mm = Field(default=86.0, gt=0)
    nut_to_mm: Mm = Field(default=94.0, gt=0)
    edge_mm: Mm = Field(default=101.5, gt=0)
    engaged_mm: Mm = Field(default=107.0, gt=0)
    hand_started_mm: Mm = Field(default=14.4, gt=0, description="how far below its seat a nut started by hand is")
    feed_step_mm: Mm = Field(default=0.5, gt=0)
    force_low_n: Newton = Field(default=5.0, gt=0)
    force_high_n: Newton = Field(default=25.0, gt=0)
    turn_speed_rpm: Rpm = Field(default=5.0, gt=0)
    turn_step_deg: Deg = Field(default=70.0, gt=0)
    turn_torque_nm: NewtonMetre = Field(default=2.0, gt=0)
    reverse_deg: Deg = Field(default=360.0, gt=0)
    start_turns_deg: Deg = Field(default=720.0, gt=0)
    max_tries: int = Field(default=3, ge=1, le=10)


class Tighten(Section):
    """`[tighten]`: nuts, stages, cooling, verification."""

    nut_supply: Literal["socket_magazine", "hand_started"] = "socket_magazine"
    order: Literal["star", "sequential"] = "star"
    thread_start_torque_nm: NewtonMetre = Field(default=6.0, gt=0)
    snug_threshold_nm: NewtonMetre = Field(default=6.0, gt=0)
    stages: tuple[Stage, ...] = ()
    engage: Engage = Engage()
    final_below_difference_k: Kelvin = Field(default=5.0, gt=0)
    cooling_timeout_s: Seconds = Field(default=7200.0, gt=0)
    verify_fraction: Fraction = Field(default=0.9, gt=0, le=1.0)
    verify_angle_high_deg: Deg = Field(default=10.0, gt=0)
    drift_gate_deg: Deg = Field(default=0.02, gt=0)
    timeout_s: Seconds = Field(default=30.0, gt=0)
    friction: Fraction = Field(default=0.14, gt=0, lt=1, description="of thread and nut face, expected")


class Limits(Section):
    """`[limits]`: what the finished joint must show."""

    gap_mm: Mm = Field(default=0.05, gt=0)
    preload_low_n: Newton = Field(default=8000.0, gt=0)
    preload_high_n: Newton = Field(default=30000.0, gt=0)
    shaft_mass_kg: Kilogram = Field(default=100.0, gt=0)
    axial_stiffness_n_per_mm: NewtonPerMm = Field(default=1350.0, gt=0)
    radial_clearance_mm: Mm = Field(default=0.15, gt=0)
    position_sigma_mm: Mm = Field(default=0.01, ge=0, description="of a hole or stud on its part, one sigma")


class Recipe(Section):
    """A whole recipe. Process sections are absent in a recipe that only measures."""

    recipe: Header
    pattern: Pattern
    shaft: PartSpec | None = None
    rotor: PartSpec | None = None
    scan: Scan = Scan()
    align: Align = Align()
    jack_up: JackUp = JackUp()
    heat: Heat = Heat()
    tighten: Tighten = Tighten()
    limits: Limits = Limits()

    @model_validator(mode="after")
    def _consistent(self) -> Recipe:
        count = self.pattern.count
        if self.shaft is None and self.rotor is None:
            raise ValueError("one of [shaft] and [rotor] is needed")
        for name, part in (("shaft", self.shaft), ("rotor", self.rotor)):
            if part is not None and isinstance(part.diameter_mm, tuple) and len(part.diameter_mm) != count:
                raise ValueError(f"{name}.diameter_mm has {len(part.diameter_mm)} entries, pattern.count is {count}")
        return self

    def part(self, side: Literal["shaft", "rotor"]) -> Part:
        """Nominal geometry of one side, as the vision core wants it. Raises ConfigError where it is not given.

        Angles of the rotor are mirrored: each part's angles are right-handed about its own outward normal, and the
        two faces look at each other (feature i of the rotor meets feature i of the shaft).
        """
        spec = self.shaft if side == "shaft" else self.rotor
        if spec is None:
            raise ConfigError("the recipe has no such part", place=side)
        angles = self.pattern.angles()
        if side == "rotor" and self.shaft is not None:
            angles = tuple(-angle for angle in angles)
        diameter = spec.diameter_mm
        if isinstance(diameter, float):
            diameter = (diameter,) * self.pattern.count
        values: dict[str, Any] = spec.model_dump(exclude={"thread", "diameter_mm"})
        return Part(
            circle_diameter_mm=self.pattern.circle_diameter_mm,
            angles_deg=angles,
            index_feature=self.pattern.index_feature,
            diameter_mm=diameter,
            thread=Thread(**spec.thread.model_dump()) if spec.thread else None,
            **values,
        )

    @property
    def content_hash(self) -> str:
        """SHA-256 of the canonical JSON: two recipes with the same numbers have the same hash."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def parse_recipe(text: str, *, source: str = "recipe") -> Recipe:
    """Recipe from TOML text. Raises ConfigError with the first wrong place; `recipe_faults` gives every one."""
    recipe, faults = parsed(Recipe, _tuples(read_toml(text, source)), source)
    if recipe is None:
        raise faults[0]
    return recipe


def recipe_faults(text: str, *, source: str = "recipe") -> list[ConfigError]:
    """Everything that is wrong with the shape and the values of a recipe, each with its place; empty where nothing is.

    Physics is another question: see `cellctl.recipe_checks`.
    """
    try:
        return parsed(Recipe, _tuples(read_toml(text, source)), source)[1]
    except ConfigError as error:
        return [error]


def recipe_schema() -> str:
    """JSON schema of a recipe, as it stands in recipes/recipe.schema.json."""
    return json.dumps(Recipe.model_json_schema(), indent=2, sort_keys=True) + "\n"


def load_recipe(path: Path) -> Recipe:
    """Recipe from a TOML file. Raises ConfigError."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", place=str(path)) from None
    return parse_recipe(text, source=path.name)


RecipeId = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]{0,63}$")]


def _tuples(value: Any) -> Any:
    """Lists of TOML as tuples, so that the strict frozen model takes them."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return value
