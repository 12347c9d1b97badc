"""What a gun meets when it turns a nut: torque and preload over the nut's rotation, as knots of straight pieces. Pure.

The knots start at rotation 0, the nut's present place. A jump (breakaway) is a piece of no rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.joints.joint import (
    JointProperties,
    NutState,
    drawn_in_n,
    elastic_n_per_deg,
    rotation_deg,
    running_torque_nm,
    torque_per_n_mm,
    travel_left_mm,
)

Array = NDArray[np.float64]
BEDDING_KNOTS = 9
CROSSED_NM_PER_DEG = 0.045
"""A nut askew on its first thread jams within half a turn."""
CROSSED_PRELOAD_N_PER_NM = 20.0


@dataclass(frozen=True, slots=True)
class Curve:
    """(n,) knots each: rotation of the nut from here (not descending), torque, preload."""

    rotation_deg: Array
    torque_nm: Array
    preload_n: Array

    def at(self, rotation_deg: float) -> tuple[float, float]:
        """(torque, preload) after `rotation_deg`."""
        return (
            float(np.interp(rotation_deg, self.rotation_deg, self.torque_nm)),
            float(np.interp(rotation_deg, self.rotation_deg, self.preload_n)),
        )


@dataclass(frozen=True, slots=True)
class Condition:
    """What holds for this one pass: scatter of friction, open gap of the faces and what resists its closing."""

    friction: float = 1.0
    gap_mm: float = 0.0
    resistance_n: float = 0.0


def tightening(properties: JointProperties, nut: NutState, condition: Condition) -> Curve:
    """From the present place over run-down, seat, elastic slope and yield, ending far beyond any target."""
    if nut.crossed:
        end = 1440.0
        torque = np.array([properties.free_torque_nm, 1.0, 1.0 + CROSSED_NM_PER_DEG * end])
        return Curve(np.array([0.0, 0.0, end]), torque, CROSSED_PRELOAD_N_PER_NM * torque)
    run = _run_down(properties, nut, condition)
    seat = float(run.rotation_deg[-1])
    clamp = _clamp(properties, nut, condition)
    return Curve(
        np.concatenate([run.rotation_deg, seat + clamp.rotation_deg]),
        np.concatenate([run.torque_nm, clamp.torque_nm]),
        np.concatenate([run.preload_n, clamp.preload_n]),
    )


def _run_down(properties: JointProperties, nut: NutState, condition: Condition) -> Curve:
    if nut.preload_n > 0.0:
        return Curve(np.zeros(1), np.zeros(1), np.full(1, nut.preload_n))
    way = travel_left_mm(properties, nut, condition.gap_mm)
    bite = properties.locking_from_mm + np.array([0.0, 0.5 * properties.pitch_mm])
    inside = bite[(bite > nut.climb_mm) & (bite < nut.climb_mm + way)]
    climb = np.concatenate([[nut.climb_mm], inside, [nut.climb_mm + way]])
    rotation = (climb - nut.climb_mm) / properties.pitch_mm * 360.0
    return Curve(rotation, running_torque_nm(properties, climb), np.zeros(len(climb)))


def _clamp(properties: JointProperties, nut: NutState, condition: Condition) -> Curve:
    """From the present preload on: closing of a gap, bedding, elastic slope, then yield or a sheared thread."""
    lever_m = 1e-3 * torque_per_n_mm(properties, nut, condition.friction)
    limit_n = properties.stripped_n if nut.stripped else properties.yield_n * nut.yield_share
    start_n = nut.preload_n
    forces, angles = [start_n], [0.0]
    closing_n = drawn_in_n(condition.gap_mm, condition.resistance_n) if start_n == 0.0 else 0.0
    if closing_n > 0.0:
        forces.append(min(closing_n, limit_n))
        angles.append(condition.gap_mm / properties.pitch_mm * 360.0)
    if forces[-1] < limit_n:
        bedded_n = 0.5 * elastic_n_per_deg(properties) * properties.bedding_deg
        base_n, base_deg = forces[-1], angles[-1]
        rising = [force for force in np.linspace(0.0, bedded_n, BEDDING_KNOTS) if base_n < force < limit_n]
        for force in (*rising, limit_n):
            forces.append(force)
            angles.append(base_deg + rotation_deg(properties, force) - rotation_deg(properties, base_n))
    torque = [properties.prevailing_nm + lever_m * force for force in forces]
    if start_n > 0.0:
        torque[0] = properties.prevailing_nm + properties.breakaway * lever_m * start_n
    _beyond(properties, nut, forces, angles, torque, lever_m)
    return Curve(np.array(angles), np.array(torque), np.array(forces))


def _beyond(
    properties: JointProperties,
    nut: NutState,
    forces: list[float],
    angles: list[float],
    torque: list[float],
    lever_m: float,
) -> None:
    """Append what comes after the limit: a sheared thread turns with little torque, a yielding stud hardens slowly."""
    last_n, last_deg = forces[-1], angles[-1]
    after: tuple[tuple[float, float], ...]
    if nut.stripped:
        after = ((40.0, 0.15 * last_n), (3600.0, 0.1 * last_n))
    else:
        after = ((3600.0, last_n + 3600.0 * properties.plastic_slope * elastic_n_per_deg(properties)),)
    for more_deg, force in after:
        forces.append(force)
        angles.append(last_deg + more_deg)
        torque.append(properties.prevailing_nm + lever_m * force)


def loosening(properties: JointProperties, nut: NutState, condition: Condition) -> Curve:
    """Backwards: rotation counts the way back; from breakaway over the loss of preload to the free nut, and off."""
    lever_m = 1e-3 * torque_per_n_mm(properties, nut, condition.friction) * properties.loosening
    rotation, torque, preload = [0.0], [properties.free_torque_nm], [nut.preload_n]
    if nut.preload_n > 0.0:
        free_deg = rotation_deg(properties, nut.preload_n)
        rotation += [0.0, free_deg]
        torque += [properties.prevailing_nm + properties.breakaway * lever_m * nut.preload_n, properties.prevailing_nm]
        preload += [nut.preload_n, 0.0]
    way_deg = nut.climb_mm / properties.pitch_mm * 360.0
    climbs = np.array([nut.climb_mm, max(min(properties.locking_from_mm, nut.climb_mm), 0.0), 0.0])
    back = (nut.climb_mm - climbs) / properties.pitch_mm * 360.0
    start = rotation[-1]
    rotation += [start + b for b in back]
    torque += [float(t) for t in running_torque_nm(properties, climbs)]
    preload += [0.0] * len(climbs)
    rotation.append(start + way_deg + 3600.0)
    torque.append(properties.free_torque_nm)
    preload.append(0.0)
    return Curve(np.array(rotation), np.array(torque), np.array(preload))


def free_spin(properties: JointProperties) -> Curve:
    """Nothing in the socket."""
    torque = np.full(2, 0.3 * properties.free_torque_nm)
    return Curve(np.array([0.0, 1e9]), torque, np.zeros(2))
