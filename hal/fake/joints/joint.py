"""One bolted joint: torque, preload, rotation, yield, cooling, neighbours. Pure functions on frozen data.

Torque of a nut (Motosh; VDI 2230-1, 5.4.2):
T = F (P / 2 pi + f mu_t d2 / (2 cos 30) + f mu_b D_b / 2) + T_prevailing, with f the scatter of friction.
Rotation beyond the seat: F grows with the square of the angle while surfaces bed in, then with the stiffness of stud
and clamped parts. Angles in degrees, positive tightens; preloads in newton.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hal.fake.geometry import JointGeometry

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class JointProperties:
    """Data of one kind of joint. Sizes follow from `properties_of`; the rest are the field's usual values."""

    pitch_mm: float
    pitch_diameter_mm: float
    bearing_diameter_mm: float
    stiffness_n_per_mm: float
    yield_n: float
    travel_mm: float
    """Of the nut from the stud's end to its seat."""
    clamp_mm: float
    expansion_per_k: float
    nut_height_mm: float
    washer_mm: float
    prevailing_nm: float
    """Self-locking torque (ISO 2320: first assembly of M8 up to 6 N m)."""
    hand: float = 1.0
    """Sense of a tightening turn seen along +z of the cell: 1 for a right-hand thread."""
    thread_friction: float = 0.14
    bearing_friction: float = 0.14
    bare_bearing_factor: float = 1.35
    """Bearing friction without the washer, relative."""
    bedding_deg: float = 8.0
    """Rotation over which the surfaces bed in."""
    plastic_slope: float = 0.01
    """Stiffness beyond yield, relative."""
    free_torque_nm: float = 0.15
    locking_from_mm: float = 6.0
    """Travel after which the locking element bites."""
    breakaway: float = 1.04
    """Static over sliding friction."""
    loosening: float = 0.8
    """Torque to loosen over torque to tighten."""
    stripped_n: float = 6000.0
    """What a damaged thread carries before it shears."""
    neighbour_loss: float = 0.16
    """Preload lost at distance 0 per newton gained next door; decays with `neighbour_mm`."""
    neighbour_mm: float = 20.0


@dataclass(frozen=True, slots=True)
class NutState:
    """One stud's nut. `climb_mm` runs from 0 at the stud's end; `hex_deg` is its orientation in the cell."""

    present: bool = False
    washer: bool = True
    climb_mm: float = 0.0
    hex_deg: float = 0.0
    preload_n: float = 0.0
    friction: float = 1.0
    yield_share: float = 1.0
    """Yield force relative to a sound stud."""
    yielded: bool = False
    stripped: bool = False
    crossed: bool = False
    passes: int = 0
    """How often a gun was run on it: friction scatters from pass to pass."""


def properties_of(geometry: JointGeometry, modulus_n_per_mm2: float = 206_000.0) -> JointProperties:
    """Joint data from its drawing: ISO 68-1 thread, ISO 4032 proportions of the nut, nickel-alloy stud.

    Stiffness by VDI 2230-1, 5.1: stud over clamp length plus 0.4 d at each end, clamped tube of 1.5 nut diameters, and
    3e-6 mm/N for threads and interfaces. Yield 1,030 N/mm2, reduced by a sixth for the torsion of tightening.
    """
    d, pitch = geometry.stud_diameter_mm, geometry.thread_pitch_mm
    washer, height = 0.2 * d, d
    clamp = geometry.hole_depth_mm + washer
    stress_mm2 = 0.25 * math.pi * (d - 0.9382 * pitch) ** 2
    bearing_outer = 1.5 * d + 1.0
    tube_mm2 = 0.25 * math.pi * ((1.5 * bearing_outer) ** 2 - geometry.hole_diameter_mm**2)
    compliance = (clamp + 0.8 * d) / (modulus_n_per_mm2 * stress_mm2) + clamp / (modulus_n_per_mm2 * tube_mm2) + 3e-6
    return JointProperties(
        pitch_mm=pitch * geometry.thread_starts,
        pitch_diameter_mm=d - 0.6495 * pitch,
        bearing_diameter_mm=0.5 * (bearing_outer + 1.05 * d),
        stiffness_n_per_mm=1.0 / compliance,
        yield_n=1030.0 * stress_mm2 / 1.2,
        travel_mm=geometry.stud_length_mm - geometry.hole_depth_mm - washer,
        clamp_mm=clamp,
        expansion_per_k=geometry.expansion_per_k,
        nut_height_mm=height,
        washer_mm=washer,
        prevailing_nm=2.5 * (d / 8.0) ** 3,
        hand=1.0 if geometry.thread_hand == "right" else -1.0,
    )


def torque_per_n_mm(properties: JointProperties, nut: NutState, friction: float = 1.0) -> float:
    """Lever K of T = K F, millimetres; `friction` scatters the pass on top of the nut's own."""
    scatter = nut.friction * friction
    bearing = properties.bearing_friction * (1.0 if nut.washer else properties.bare_bearing_factor)
    return (
        properties.pitch_mm / (2.0 * math.pi)
        + scatter * properties.thread_friction * properties.pitch_diameter_mm / (2.0 * math.cos(math.pi / 6.0))
        + scatter * bearing * 0.5 * properties.bearing_diameter_mm
    )


def elastic_n_per_deg(properties: JointProperties) -> float:
    """Preload gained per degree once bedded in."""
    return properties.stiffness_n_per_mm * properties.pitch_mm / 360.0


def rotation_deg(properties: JointProperties, preload_n: float) -> float:
    """Rotation from the seat to an elastic `preload_n`."""
    slope, bedding = elastic_n_per_deg(properties), properties.bedding_deg
    bedded_n = 0.5 * slope * bedding
    if preload_n < bedded_n:
        return math.sqrt(2.0 * bedding * max(preload_n, 0.0) / slope)
    return preload_n / slope + 0.5 * bedding


def travel_left_mm(properties: JointProperties, nut: NutState, gap_mm: float) -> float:
    """Way of the nut to its seat: shorter by an open gap of the faces, longer without the washer."""
    washer = 0.0 if nut.washer else properties.washer_mm
    return max(properties.travel_mm + washer - gap_mm - nut.climb_mm, 0.0)


def running_torque_nm(properties: JointProperties, climb_mm: Array) -> Array:
    """Torque of the free nut at `climb_mm` (n,): the locking element bites within half a turn."""
    bite = np.clip((climb_mm - properties.locking_from_mm) / (0.5 * properties.pitch_mm), 0.0, 1.0)
    return np.asarray(properties.free_torque_nm + bite * (properties.prevailing_nm - properties.free_torque_nm))


def cooled(properties: JointProperties, nut: NutState, change_k: float) -> NutState:
    """The nut after the clamped flange has changed its temperature against the stud by `change_k`."""
    if nut.preload_n <= 0.0:
        return nut
    gained_n = properties.stiffness_n_per_mm * properties.expansion_per_k * properties.clamp_mm * change_k
    return replace(nut, preload_n=max(nut.preload_n + gained_n, 0.0))


def interaction(properties: JointProperties, stud_mm: Array) -> Array:
    """(n, n) preload that joint i loses per newton that joint j gains (elastic interaction); zero diagonal.

    Decays with the distance of the studs (Bickford, Introduction to the Design and Behavior of Bolted Joints, 6).
    """
    distance = np.linalg.norm(stud_mm[:, None, :] - stud_mm[None, :, :], axis=2)
    loss = properties.neighbour_loss * np.exp(-distance / properties.neighbour_mm)
    np.fill_diagonal(loss, 0.0)
    return np.asarray(np.where(loss < 1e-4, 0.0, loss))


def slip_deg(torque_nm: float, hold_nm: float, room_deg: float) -> float:
    """How far the shaft turns in its clearance: not at all while it is held, else as far as there is room."""
    return math.copysign(room_deg, torque_nm) if abs(torque_nm) > hold_nm else 0.0


def drawn_in_n(gap_mm: float, resistance_n: float, flange_n_per_mm: float = 20_000.0) -> float:
    """Preload that closes an open gap at one joint: what resists (press fit, hanging weight) and the flange's bow."""
    return resistance_n + flange_n_per_mm * gap_mm if gap_mm > 0.0 else 0.0
