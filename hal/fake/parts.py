"""Truth of one rotor, one shaft and one cell, drawn from the tables. Each quantity has a generator of its own.

Feature axes are given as a point on the part's face and slopes: at height z of the part frame the axis is at
``position + z * slope``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.frames import child_rng, pose, rotation_z, small_pose
from hal.fake.geometry import BenchGeometry, JointGeometry
from hal.fake.levels import TwinNumbers

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RotorTruth:
    """Studs (n, 2) in the rotor's part frame (z down), slopes (n, 2), crest diameters (n,)."""

    serial: str
    stud_mm: Array
    slope: Array
    diameter_mm: Array
    T_cell_rotor: Array


@dataclass(frozen=True, slots=True)
class ShaftTruth:
    """Holes (n, 2) in the shaft's part frame (z up), slopes (n, 2), diameters (n,), and how it sits in the chuck."""

    serial: str
    hole_mm: Array
    slope: Array
    diameter_mm: Array
    T_chuck_shaft: Array
    mass_kg: float
    interference_mm: float
    """Diametral, both members at 20 C."""


@dataclass(frozen=True, slots=True)
class CellTruth:
    """The bench as it really is.

    Smooth errors of the jack are sums of odd quarter waves over the stroke: ``straightness`` (3, 2) in mm, ``roll``
    (3,) in rad. The table's encoder error is ``amplitude sin(theta + phase)``.
    """

    T_cell_camera_rotor: Array
    T_cell_camera_shaft: Array
    table_point_mm: Array
    table_direction: Array
    encoder_amplitude_rad: float
    encoder_phase_rad: float
    runout_mm: Array
    jack_slope: Array
    straightness_mm: Array
    roll_rad: Array
    backlash_mm: Array
    """Of x, y and jack."""
    scale: Array
    """Of x, y and jack, relative."""
    stage: Array
    """(2, 2) rows: directions of x and y in the cell's plane."""
    force_gain: float
    guide_friction_n: Array
    """(3,): constant part, amplitude and phase of the part that varies with height."""
    scanner_scale: float


def draw_rotor(
    geometry: JointGeometry, bench: BenchGeometry, numbers: TwinNumbers, seed: int, serial: str
) -> RotorTruth:
    """One rotor by serial number."""
    table, n = numbers.imperfections, geometry.count
    position = child_rng(seed, "rotor", serial, "position").normal(0.0, table.feature_position_mm, (n, 2))
    slope = child_rng(seed, "rotor", serial, "tilt").normal(0.0, math.radians(table.feature_tilt_deg), (n, 2))
    shift = child_rng(seed, "rotor", serial, "eccentricity").normal(0.0, table.rotor_eccentricity_mm, 2)
    clocking = child_rng(seed, "rotor", serial, "clocking").normal(0.0, math.radians(table.rotor_clocking_deg))
    down = rotation_z(clocking) @ np.diag([1.0, -1.0, -1.0])
    return RotorTruth(
        serial=serial,
        stud_mm=geometry.pattern_mm("rotor") + position,
        slope=slope,
        diameter_mm=np.full(n, _or(numbers.properties.stud_diameter_mm, geometry.stud_diameter_mm)),
        T_cell_rotor=pose(down, np.array([*shift, bench.rotor_face_mm])),
    )


def draw_shaft(geometry: JointGeometry, numbers: TwinNumbers, seed: int, serial: str) -> ShaftTruth:
    """One shaft by serial number, and how it was put into the chuck."""
    table, true, n = numbers.imperfections, numbers.properties, geometry.count
    position = child_rng(seed, "shaft", serial, "position").normal(0.0, table.feature_position_mm, (n, 2))
    slope = child_rng(seed, "shaft", serial, "tilt").normal(0.0, math.radians(table.feature_tilt_deg), (n, 2))
    nominal = geometry.pattern_mm("shaft") * (1.0 + true.circle_diameter_shift_mm / geometry.circle_diameter_mm)
    position[0] += true.hole_0_shift_x_mm, true.hole_0_shift_y_mm
    shift = child_rng(seed, "shaft", serial, "eccentricity").normal(0.0, table.chuck_eccentricity_mm, 2)
    tilt = child_rng(seed, "shaft", serial, "seat").normal(0.0, table.chuck_tilt_deg, 2)
    clocking = child_rng(seed, "shaft", serial, "clocking").uniform(-1.0, 1.0) * table.chuck_clocking_deg
    tilt_deg = np.array([tilt[0] + true.shaft_tilt_x_deg, tilt[1] + true.shaft_tilt_y_deg, 0.0])
    # The tilt is of the seat, so it comes after the clocking.
    seat = small_pose(np.array([*shift, 0.0]), tilt_deg) @ small_pose(np.zeros(3), np.array([0.0, 0.0, clocking]))
    fit = child_rng(seed, "shaft", serial, "fit").normal(0.0, table.fit_interference_mm)
    mass = child_rng(seed, "shaft", serial, "mass").normal(0.0, table.shaft_mass_kg)
    return ShaftTruth(
        serial=serial,
        hole_mm=nominal + position,
        slope=slope,
        diameter_mm=np.full(n, _or(true.hole_diameter_mm, geometry.hole_diameter_mm)),
        T_chuck_shaft=seat,
        mass_kg=_or(true.shaft_mass_kg, geometry.shaft_mass_kg) + mass,
        interference_mm=_or(true.fit_interference_mm, geometry.interference_mm) + fit,
    )


def draw_cell(bench: BenchGeometry, numbers: TwinNumbers, seed: int) -> CellTruth:
    """One cell: the same for every part that it sees."""
    table, true = numbers.imperfections, numbers.properties

    def normal(name: str, sigma: float, size: int | tuple[int, ...]) -> Array:
        return child_rng(seed, "cell", name).normal(0.0, sigma, size)

    waves = np.array([0.8, 0.5, math.sqrt(0.11)])  # squares sum to 1: at full stroke the sigma is the table's
    table_tilt = np.radians([true.table_axis_tilt_x_deg, true.table_axis_tilt_y_deg])
    jack_tilt = np.tan(np.radians([true.jack_line_tilt_x_deg, true.jack_line_tilt_y_deg]))
    friction = child_rng(seed, "cell", "guide")
    return CellTruth(
        T_cell_camera_rotor=bench.T_cell_camera_rotor @ _view_error(numbers, seed, "rotor"),
        T_cell_camera_shaft=bench.T_cell_camera_shaft @ _view_error(numbers, seed, "shaft"),
        table_point_mm=np.array([true.table_axis_shift_x_mm, true.table_axis_shift_y_mm, 0.0]),
        table_direction=small_pose(np.zeros(3), np.degrees([*table_tilt, 0.0]))[:3, 2],
        encoder_amplitude_rad=float(normal("encoder", math.radians(table.table_encoder_deg) * math.sqrt(2.0), 1)[0]),
        encoder_phase_rad=float(child_rng(seed, "cell", "encoder phase").uniform(0.0, 2.0 * math.pi)),
        runout_mm=normal("runout", table.table_runout_mm, 2),
        jack_slope=normal("jack line", math.radians(table.jack_direction_deg), 2) + jack_tilt,
        straightness_mm=normal("straightness", table.jack_straightness_mm, (3, 2)) * waves[:, None],
        roll_rad=normal("roll", math.radians(table.jack_roll_deg), 3) * waves,
        backlash_mm=np.abs(normal("backlash", table.axis_backlash_mm, 3)),
        scale=normal("scale", table.axis_scale, 3),
        stage=_stage(true.stage_x_turn_deg, true.stage_y_turn_deg),
        force_gain=float(true.force_gain * (1.0 + normal("force gain", table.force_gain, 1)[0])),
        guide_friction_n=np.array(
            [table.guide_friction_n, 0.1 * table.guide_friction_n, friction.uniform(0.0, 2.0 * math.pi)]
        ),
        scanner_scale=float(normal("scanner scale", table.scanner_scale, 1)[0]),
    )


def _view_error(numbers: TwinNumbers, seed: int, view: str) -> Array:
    """(4, 4) of the true camera in its nominal frame: half of the view-to-view variance each, plus perturbations."""
    table, true = numbers.imperfections, numbers.properties
    rng = child_rng(seed, "cell", "view", view)
    rotation = rng.normal(0.0, table.view_rotation_deg / math.sqrt(2.0), 3)
    shift = rng.normal(0.0, table.view_translation_mm / math.sqrt(2.0), 3)
    if view == "rotor":
        shift += true.camera_rotor_shift_x_mm, true.camera_rotor_shift_y_mm, true.camera_rotor_shift_z_mm
        rotation += true.camera_rotor_rotation_x_deg, true.camera_rotor_rotation_y_deg, true.camera_rotor_rotation_deg
    else:
        shift += true.camera_shaft_shift_x_mm, true.camera_shaft_shift_y_mm, true.camera_shaft_shift_z_mm
        rotation += true.camera_shaft_rotation_x_deg, true.camera_shaft_rotation_y_deg, true.camera_shaft_rotation_deg
    return small_pose(shift, rotation)


def _stage(x_turn_deg: float, y_turn_deg: float) -> Array:
    x, y = np.radians([x_turn_deg, y_turn_deg])
    return np.array([[np.cos(x), np.sin(x)], [-np.sin(y), np.cos(y)]])


def _or(value: float, nominal: float) -> float:
    return nominal if math.isnan(value) else value
