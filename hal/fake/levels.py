"""How imperfect the twin is: every number named, with unit and source, by level, each overridable by name.

`Imperfections` are one-sigma scatters that a level scales; `Properties` are true physical quantities and deliberate
perturbations of the truth, which no level scales. A test that wants the truth to differ from the controller's belief
overrides a property.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from hal.errors import ConfigError

Level = Literal["ideal", "nominal", "hostile"]
HOSTILE_SCALE = 3.0


def _n(
    value: float, unit: str, *, scaled: bool = True, hostile: float | None = None, ideal: float | None = None
) -> float:
    """Field with its nominal value. `scaled`: zero when ideal, three times as large when hostile."""
    return field(default=value, metadata={"unit": unit, "scaled": scaled, "hostile": hostile, "ideal": ideal})


@dataclass(frozen=True, slots=True)
class Imperfections:
    """One sigma, per axis unless said."""

    view_rotation_deg: float = _n(0.002, "deg")
    """View to view after calibration, about the camera's pinhole; the sum over both views."""
    view_translation_mm: float = _n(0.005, "mm")
    jack_direction_deg: float = _n(0.002, "deg")
    jack_straightness_mm: float = _n(0.005, "mm")
    jack_roll_deg: float = _n(0.001, "deg")
    table_encoder_deg: float = _n(0.003, "deg")
    table_runout_mm: float = _n(0.003, "mm")
    axis_backlash_mm: float = _n(0.003, "mm")
    axis_scale: float = _n(20e-6, "1")
    feature_position_mm: float = _n(0.010, "mm")
    feature_tilt_deg: float = _n(0.02, "deg")
    chuck_eccentricity_mm: float = _n(2.0, "mm")
    chuck_tilt_deg: float = _n(0.015, "deg")
    chuck_clocking_deg: float = _n(180.0, "deg", hostile=180.0)
    """Half range of a uniform distribution."""
    rotor_eccentricity_mm: float = _n(0.1, "mm")
    rotor_clocking_deg: float = _n(0.05, "deg")

    scanner_noise_mm: float = _n(0.03, "mm", ideal=0.005)
    """Along the ray, normal incidence, 350 mm."""
    scanner_correlation_px: float = _n(3.0, "px", scaled=False)
    scanner_ripple_mm: float = _n(0.010, "mm")
    scanner_scale: float = _n(50e-6, "1")
    scanner_outliers: float = _n(0.02, "1", hostile=0.06)
    """Share of the pixels."""

    fit_interference_mm: float = _n(0.005, "mm")
    """Scatter of the diametral interference about the drawing's."""
    shaft_mass_kg: float = _n(1.0, "kg")
    docking_difference_k: float = _n(3.0, "K")
    friction_per_nut: float = _n(0.08, "1")
    friction_per_pass: float = _n(0.03, "1")

    force_noise_n: float = _n(0.1, "N", ideal=0.01)
    """White, after the amplifier's filter. No converter is without: a signal that stands still is a dead one."""
    force_gain: float = _n(0.002, "1")
    force_linearity: float = _n(0.0002, "1")
    """Of the range, at mid range (class C3 load cell, OIML R 60)."""
    force_hysteresis: float = _n(0.0002, "1")
    """Of the present contact force."""
    force_creep: float = _n(0.0002, "1")
    """Of the standing load, with `force_creep_s` (OIML R 60: 0.02 % in 30 min)."""
    guide_friction_n: float = _n(2.0, "N")
    """Coulomb friction of the jack's guides; a tenth of it varies with height."""


@dataclass(frozen=True, slots=True)
class Properties:
    """True physical quantities, and perturbations of the truth (zero where nothing is perturbed)."""

    lateral_stiffness_n_per_mm: float = _n(1000.0, "N/mm")
    """Chuck and column, in x, y and tangentially at the bolt circle (design book, contact)."""
    axial_stiffness_n_per_mm: float = _n(1350.0, "N/mm")
    """Jack column against a jam or a seated face (design book, contact)."""
    friction_coefficient: float = _n(0.15, "1")
    stud_modulus_n_per_mm2: float = _n(206_000.0, "N/mm2")
    stud_fixity: float = _n(12.0, "1")
    """End condition of a bending stud: 3 free to turn, 12 guided by its hole."""
    spigot_stiffness_n_per_mm: float = _n(2.0e5, "N/mm")
    """Local radial stiffness of the rabbet ring where it centres the shaft."""
    chuck_tilt_stiffness_nmm_per_rad: float = _n(3.0e7, "N mm/rad")
    """Of the column under the chuck: k h^2 / 3 for a cantilever of h = 300 mm with the lateral stiffness k."""
    damage_force_n: float = _n(500.0, "N")
    """Axial or lateral force on one stud that ruins its first thread."""
    contact_damping: float = _n(0.1, "1")
    """Damping ratio of the shaft's mass on a contact."""
    force_delay_s: float = _n(0.002, "s")
    """Filter delay of the force amplifier."""
    force_creep_s: float = _n(600.0, "s")
    force_gain: float = _n(1.0, "1")
    """Reading over true force."""
    brake_delay_s: float = _n(0.05, "s")
    brake_late_s: float = _n(0.0, "s")
    """The brake closes so long after the torque has gone: the load falls meanwhile."""
    drive_delay_s: float = _n(0.005, "s")
    """From a halt command to the first deceleration: bus and drive cycle."""
    part_exchange_s: float = _n(30.0, "s")
    """Presenting rotor and shaft takes so long."""
    nut_load_s: float = _n(2.0, "s")
    """The feeder takes so long to put a nut into a socket."""
    camera_swing_s: float = _n(4.0, "s")
    """The camera's arm takes so long from one place to another."""
    ambient_c: float = _n(20.0, "Cel")
    fit_interference_mm: float = _n(math.nan, "mm")
    """Replaces the drawing's nominal interference."""
    shaft_mass_kg: float = _n(math.nan, "kg")
    """Replaces the drawing's mass."""
    hole_diameter_mm: float = _n(math.nan, "mm")
    """Replaces the drawing's hole diameter."""
    stud_diameter_mm: float = _n(math.nan, "mm")
    circle_diameter_shift_mm: float = _n(0.0, "mm")
    """The shaft's bolt circle is larger than drawn by this."""
    hole_0_shift_x_mm: float = _n(0.0, "mm")
    hole_0_shift_y_mm: float = _n(0.0, "mm")
    camera_rotor_shift_x_mm: float = _n(0.0, "mm")
    camera_rotor_shift_y_mm: float = _n(0.0, "mm")
    camera_rotor_shift_z_mm: float = _n(0.0, "mm")
    camera_rotor_rotation_x_deg: float = _n(0.0, "deg")
    camera_rotor_rotation_y_deg: float = _n(0.0, "deg")
    camera_rotor_rotation_deg: float = _n(0.0, "deg")
    """About the camera's optical axis."""
    camera_shaft_shift_x_mm: float = _n(0.0, "mm")
    camera_shaft_shift_y_mm: float = _n(0.0, "mm")
    camera_shaft_shift_z_mm: float = _n(0.0, "mm")
    camera_shaft_rotation_x_deg: float = _n(0.0, "deg")
    camera_shaft_rotation_y_deg: float = _n(0.0, "deg")
    camera_shaft_rotation_deg: float = _n(0.0, "deg")
    table_axis_shift_x_mm: float = _n(0.0, "mm")
    table_axis_shift_y_mm: float = _n(0.0, "mm")
    table_axis_tilt_x_deg: float = _n(0.0, "deg")
    table_axis_tilt_y_deg: float = _n(0.0, "deg")
    jack_line_tilt_x_deg: float = _n(0.0, "deg")
    """The jack drifts towards +x by this angle."""
    jack_line_tilt_y_deg: float = _n(0.0, "deg")
    shaft_tilt_x_deg: float = _n(0.0, "deg")
    shaft_tilt_y_deg: float = _n(0.0, "deg")


@dataclass(frozen=True, slots=True)
class TwinNumbers:
    """All numbers of one twin. An override whose name is in both tables goes to the property."""

    imperfections: Imperfections = Imperfections()
    properties: Properties = Properties()
    overrides: Mapping[str, float] = field(default_factory=dict)

    def with_overrides(self, overrides: Mapping[str, float]) -> TwinNumbers:
        """Copy with numbers replaced by name. ``sigma_NAME`` means the imperfection where both tables have NAME.

        Raises ConfigError naming an unknown name or a value that is not finite.
        """
        scatter, truth = names(Imperfections), names(Properties)
        changed: dict[str, float] = {}
        set_: dict[str, float] = {}
        for name, value in overrides.items():
            if not math.isfinite(value):
                raise ConfigError(f"must be finite, got {value}", place=f"twin.overrides.{name}")
            if name in truth:
                set_[name] = value
            elif name in scatter:
                changed[name] = value
            elif name.removeprefix("sigma_") in scatter:
                changed[name.removeprefix("sigma_")] = value
            else:
                raise ConfigError("is not a number of the twin", place=f"twin.overrides.{name}")
        return TwinNumbers(
            dataclasses.replace(self.imperfections, **changed),
            dataclasses.replace(self.properties, **set_),
            {**self.overrides, **overrides},
        )


def names(table: type[Imperfections] | type[Properties]) -> frozenset[str]:
    """The names of one table."""
    return frozenset(entry.name for entry in dataclasses.fields(table))


def unit_of(name: str) -> str:
    """Unit of a number by name. Raises KeyError."""
    for table in (Properties, Imperfections):
        for entry in dataclasses.fields(table):
            if entry.name == name:
                return str(entry.metadata["unit"])
    raise KeyError(name)


def imperfections(level: Level) -> Imperfections:
    """The table of one level: ideal is all zero (scanner noise apart), hostile three times nominal."""
    values: dict[str, float] = {}
    for entry in dataclasses.fields(Imperfections):
        value = float(entry.default)  # type: ignore[arg-type]
        special = entry.metadata.get(level)
        if special is not None:
            value = special
        elif entry.metadata["scaled"]:
            value *= {"ideal": 0.0, "nominal": 1.0, "hostile": HOSTILE_SCALE}[level]
        values[entry.name] = value
    return Imperfections(**values)


def numbers(level: Level, overrides: Mapping[str, float] | None = None) -> TwinNumbers:
    """All numbers of one level, overridden by name. Raises ConfigError."""
    return TwinNumbers(imperfections(level)).with_overrides(overrides or {})
