"""The nuts of one plant: what is on each stud, what its neighbours, heat and reaction do to it."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hal.fake.contact.press import press_slope_n_per_mm
from hal.fake.heat.state import Thermal
from hal.fake.joints.curve import Condition
from hal.fake.joints.joint import JointProperties, NutState, cooled, interaction, properties_of, slip_deg
from hal.fake.plant import Plant

Array = NDArray[np.float64]
Error = Literal["cross_thread", "slip_off", "missing_washer", "stripped_thread", "yielded_stud"]
CHUCK_HOLD_NM = 400.0
HELD_BY_JACK_N = 300.0
"""Least force with which the faces rest on each other during tightening."""


class Nuts:
    """One nut state per stud, for the parts that are in the plant."""

    def __init__(self, plant: Plant) -> None:
        self.properties: JointProperties = properties_of(plant.geometry)
        self._plant = plant
        self.shaft = plant.shaft
        self.state = [NutState() for _ in range(plant.geometry.count)]
        self.planted: dict[int, set[Error]] = {}
        length = plant.geometry.stud_length_mm
        ends = np.column_stack([plant.rotor.stud_mm + length * plant.rotor.slope, np.full(len(self.state), length)])
        pose = plant.T_cell_rotor()
        self.stud_end_mm: Array = ends @ pose[:3, :3].T + pose[:3, 3]
        self._loss = interaction(self.properties, plant.rotor.stud_mm)
        self._difference_k = 0.0
        self._slipped_deg = 0.0
        self.started_by_hand = False

    def preload_n(self) -> Array:
        """(n,) present preload of each stud."""
        return np.array([nut.preload_n for nut in self.state])

    def yielded(self) -> NDArray[np.bool_]:
        """(n,) studs beyond yield, threads stripped or crossed."""
        return np.array([nut.yielded or nut.stripped or nut.crossed for nut in self.state])

    def put(self, joint: int, nut: NutState) -> None:
        """Set one nut; its neighbours lose preload as it gains."""
        gained = nut.preload_n - self.state[joint].preload_n
        self.state[joint] = nut
        if gained <= 0.0:
            return
        for other in np.flatnonzero(self._loss[joint]):
            neighbour = self.state[other]
            if neighbour.preload_n > 0.0:
                left = max(neighbour.preload_n - self._loss[joint, other] * gained, 0.0)
                self.state[other] = replace(neighbour, preload_n=float(left))

    def moved(self, nut: NutState, rotation_deg: float, preload_n: float) -> NutState | None:
        """The nut after it has turned by `rotation_deg` to `preload_n`; None when it has come off."""
        properties = self.properties
        climb = nut.climb_mm + rotation_deg / 360.0 * properties.pitch_mm
        if climb < 0.0:
            return None
        seat = properties.travel_mm + (0.0 if nut.washer else properties.washer_mm)
        yielded = nut.yielded or preload_n >= 0.9999 * properties.yield_n * nut.yield_share
        return replace(nut, present=True, climb_mm=min(climb, seat), preload_n=preload_n, yielded=yielded)

    def fresh(self, joint: int, climb_mm: float) -> NutState:
        """A new nut with its own friction."""
        scatter = self._plant.numbers.imperfections.friction_per_nut
        friction = float(np.exp(scatter * self.rng("nut", joint).standard_normal()))
        washer = "missing_washer" not in self.planted.get(joint, ())
        return NutState(present=True, washer=washer, climb_mm=climb_mm, friction=friction)

    def start_by_hand(self) -> None:
        """An operator puts a nut on every bare stud, two turns deep."""
        self.started_by_hand = True
        for joint, nut in enumerate(self.state):
            if not nut.present:
                self.put(joint, self.fresh(joint, 2.0 * self.properties.pitch_mm))

    def struck(self, joint: int) -> NutState:
        """The nut, with the errors that were planted in it."""
        planted, nut = self.planted.get(joint, set()), self.state[joint]
        if "stripped_thread" in planted and not nut.stripped:
            nut = replace(nut, stripped=True)
        if "yielded_stud" in planted and nut.yield_share == 1.0:
            nut = replace(nut, yield_share=0.4)
        self.state[joint] = nut
        return nut

    def condition(self, joint: int) -> Condition:
        """Friction of the coming pass, and what is to be closed before the nut sits."""
        nut = self.state[joint]
        scatter = self._plant.numbers.imperfections.friction_per_pass
        friction = float(np.exp(scatter * self.rng("pass", joint, nut.passes).standard_normal()))
        if nut.preload_n > 0.0:
            return Condition(friction)
        x, y, _ = self.stud_end_mm[joint]
        gap = self._plant.gap_at(float(x), float(y))
        return Condition(friction, gap, self._press_n() / len(self.state) if gap > 0.0 else 0.0)

    def react(self, torque_nm: float) -> None:
        """The guns' reaction (signed about +z) against whatever holds the shaft: chuck, spigot, faces, tight joints."""
        geometry, friction = self._plant.geometry, self._plant.numbers.properties.friction_coefficient
        circle_mm = 0.5 * geometry.circle_diameter_mm
        hold = CHUCK_HOLD_NM if self._plant.chuck_clamped else 0.0
        hold += 0.5e-3 * geometry.spigot_diameter_mm * self._press_n()
        hold += friction * 1e-3 * circle_mm * (HELD_BY_JACK_N + float(np.sum(self.preload_n())))
        room = float(np.degrees(geometry.clearance_mm / circle_mm)) - abs(self._slipped_deg)
        turned = slip_deg(torque_nm, hold, max(room, 0.0))
        if turned:
            self._slipped_deg += turned
            self._plant.turn_shaft(turned)

    def follow_temperature(self) -> None:
        """Preload follows the clamped flange's temperature against the studs'."""
        thermal = self._plant.thermal
        if not isinstance(thermal, Thermal):
            return
        change = thermal.clamp_difference_k - self._difference_k
        if abs(change) > 0.05:
            self._difference_k += change
            self.state = [cooled(self.properties, nut, change) for nut in self.state]

    def rng(self, what: str, joint: int, number: int = 0) -> np.random.Generator:
        """Generator for one event at one joint of these parts."""
        return self._plant.rng("joints", self.shaft.serial, what, str(joint), str(number))

    def _press_n(self) -> float:
        """Axial force that the gripped spigot holds."""
        geometry, true, thermal = self._plant.geometry, self._plant.numbers.properties, self._plant.thermal
        fit_mm = thermal.interference_mm if isinstance(thermal, Thermal) else self.shaft.interference_mm
        slope = press_slope_n_per_mm(geometry, fit_mm, true.stud_modulus_n_per_mm2, true.friction_coefficient)
        return slope * min(max(geometry.spigot_length_mm - self._plant.gap_mm(), 0.0), geometry.spigot_length_mm)
