"""The plant: one physical truth behind every fake. Actuators write into it, sensors and camera read from it.

How a fake uses it (always `advance` first; time is the event loop's)::

    plant.advance(now)
    plant.start_move("jack", 380.0, speed=10.0, acceleration=50.0, now=now); plant.stop("jack", 50.0, now)
    plant.motion["gun_table"].position(now)          # motor position = what an encoder reads, mm or deg
    plant.T_cell_shaft(), T_cell_rotor(), T_cell_camera("rotor" | "shaft")     # true poses at the last `advance`
    plant.gap_mm(), plant.gap_at(x_mm, y_mm)          # true distance of the faces along z, >= 0, contact included
    plant.jack_force_n(times)                         # what the jack's sensor carries at times (k,), raw newton
    plant.closing_resistance_n()                      # axial force that closes the joint now
    plant.rotor, plant.shaft, plant.cell              # RotorTruth, ShaftTruth, CellTruth (features, axes errors)
    plant.load_parts("R-1", "S-1")                    # other parts, drawn from seed and serial numbers
    plant.bare, plant.probe_mm(0)                     # a fixture (hal.fake.fixtures) in place of both parts
    plant.set_tools(enabled=False), plant.on_tools(callback)   # the output without which no gun turns
    plant.set_chuck(clamped=True), plant.turn_shaft(0.01)      # shaft turned in its chuck by reaction torque, deg
    plant.camera = "parked" | "rotor" | "shaft" | "moving"     # where the camera's arm is
    plant.thermal, plant.joints                       # heat and nuts, see hal.fake.slots
    plant.numbers.imperfections, plant.numbers.properties      # every number, overrides applied
    plant.rng("gun_a", "friction")                    # generator of your own, same for the same names
    plant.damage("what")                              # something was hit or overloaded: the joint is not good
    plant.subscribe(callback) -> unsubscribe          # called whenever a motion changes

The controller never sees any of this; `hal.fake.truth.truth_of` is the one door by which truth leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hal.fake.contact.engagement import Engagement, closing_resistance_n
from hal.fake.contact.insertion import Dock
from hal.fake.fixtures import MANDREL, MANDREL_KG, Mandrel, draw_mandrel, weight_kg
from hal.fake.frames import child_rng
from hal.fake.geometry import BenchGeometry, JointGeometry
from hal.fake.levels import Level, TwinNumbers, numbers
from hal.fake.motion import AxisMotion, Trajectory
from hal.fake.parts import RotorTruth, ShaftTruth, draw_cell, draw_rotor, draw_shaft
from hal.fake.slots import Isothermal, JointsTruth, Loose, ThermalTruth
from hal.fake.stack import Motors, T_cell_table
from hal.units import GRAVITY_M_S2

Array = NDArray[np.float64]
CameraPlace = Literal["parked", "rotor", "shaft", "moving"]
STEP_S = 0.25
"""Between two looks at the heat while the spigot engages."""
GRAVITY_MM_S2 = 1e3 * GRAVITY_M_S2
GUIDE_PITCH_MM = 40.0
"""Over which the guides' friction varies: the pitch of the balls' recirculation."""
CLOSED_N = 50_000.0
AXES = ("stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed")


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """`[twin]` of the cell file."""

    seed: int = 1
    level: Level = "nominal"
    overrides: Mapping[str, float] = field(default_factory=dict)


class Plant:
    """The whole physical state, advanced lazily."""

    def __init__(
        self, geometry: JointGeometry, settings: TwinSettings, bench: BenchGeometry | None = None, now: float = 0.0
    ) -> None:
        """Raises ConfigError where an override is unknown."""
        self.geometry = geometry
        self.settings = settings
        self.bench = bench or BenchGeometry()
        self.numbers: TwinNumbers = numbers(settings.level, settings.overrides)
        self.now = now
        self.motion = {name: AxisMotion(now=now) for name in AXES}
        self.cell = draw_cell(self.bench, self.numbers, settings.seed)
        self.camera: CameraPlace = "parked"
        self.chuck_clamped = True
        self.tools_enabled = True
        self.thermal: ThermalTruth = Isothermal(self.numbers.properties.ambient_c, lambda: self.shaft)
        self.joints: JointsTruth = Loose(geometry.count)
        self.damages: list[str]
        self.engagement: Engagement
        self._listeners: list[Callable[[], None]] = []
        self._tool_listeners: list[Callable[[], None]] = []
        self.rotor: RotorTruth
        self.shaft: ShaftTruth
        self.load_parts("rotor-0", "shaft-0")

    # ------------------------------------------------------------ parts and random children

    def rng(self, *names: str) -> np.random.Generator:
        """Generator of its own for `names`, from the twin's seed."""
        return child_rng(self.settings.seed, *names)

    def load_parts(self, rotor_serial: str, shaft_serial: str) -> None:
        """Put another rotor and shaft in: same serial numbers, same parts. A fixture comes in place of both."""
        seed = self.settings.seed
        self.rotor = draw_rotor(self.geometry, self.bench, self.numbers, seed, rotor_serial)
        self.shaft = draw_shaft(self.geometry, self.numbers, seed, shaft_serial)
        axis_mm = self.cell.table_point_mm[:2]
        self.mandrel = draw_mandrel(seed, shaft_serial, axis_mm) if shaft_serial.startswith(MANDREL) else None
        mass_kg = MANDREL_KG if self.mandrel else weight_kg(seed, shaft_serial)
        self.bare = mass_kg is not None
        if mass_kg is not None:
            self.shaft = replace(self.shaft, mass_kg=mass_kg)
        self.slip_deg = 0.0
        self.loaded_s = self.now
        self._last_gap_mm = self.bench.rotor_face_mm - self.motion["jack"].position(self.now)
        self._gripped_mm = math.inf
        self.engagement = Engagement(self.geometry.count)
        self.damages = []
        self._bracket_mm = self._mandrel_mm(self.mandrel) if self.mandrel else np.zeros(2)

    def damage(self, what: str) -> None:
        """Note once that something was hit or overloaded."""
        if what not in self.damages:
            self.damages.append(what)

    # ------------------------------------------------------------ time and motion

    def advance(self, now: float) -> None:
        """Integrate up to `now`; earlier times are ignored."""
        while self.now < now:
            self._step(min(now, self.now + STEP_S) if self._closing() else now)

    def _closing(self) -> bool:
        """Whether the jack moves where the gap decides the heat flow."""
        return self.motion["jack"].moving(self.now) and self._last_gap_mm < 2.0 * self.geometry.spigot_length_mm

    def _step(self, now: float) -> None:
        self.thermal.advance(now, self._last_gap_mm)
        before, self.now = self.now, now
        self._collide(before)
        jack = self.motion["jack"]
        at = jack.position(now)
        low, high = sorted((jack.position(before), at))
        if not self._reaches(high):
            self._last_gap_mm = self.bench.rotor_face_mm - at
            return
        dock = self.dock()
        curve = self.engagement.curve(dock, low) if high > low else self.engagement.near(dock, high)
        self._follow_grip(curve.gap_at(at), pulled=at < jack.position(before))
        self._last_gap_mm = self._held(curve.gap_at(at))
        if self.engagement.record(curve, low, high, self.geometry.spigot_length_mm):
            worst = np.maximum(self.engagement.peak_n, self.engagement.lateral_peak_n)
            for stud in np.flatnonzero(worst > self.numbers.properties.damage_force_n):
                self.damage(f"stud {stud} was overloaded")
        if high > low:
            entered = self.geometry.entry_gap_mm - self.geometry.lead_in_mm - self.geometry.chamfer_depth_mm
            if curve.gap_at(low) > entered >= curve.gap_at(high):
                self.engagement.enter(dock)

    def _follow_grip(self, gap_mm: float, *, pulled: bool) -> None:
        """A spigot that grips holds what was pressed in: friction resists a pull, it pushes nothing out."""
        held_mm = math.inf if pulled else min(gap_mm, self._gripped_mm)
        engaged = held_mm < self.geometry.spigot_length_mm - self.geometry.spigot_chamfer_mm
        self._gripped_mm = held_mm if engaged else math.inf

    def _held(self, gap_mm: float) -> float:
        return max(min(gap_mm, self._gripped_mm), 0.0)

    def _reaches(self, motor_mm: float) -> bool:
        """Whether studs and shaft can touch with the jack at `motor_mm`; a millimetre early."""
        return not self.bare and self.bench.rotor_face_mm - motor_mm < self.geometry.entry_gap_mm + 1.0

    def _collide(self, before: float) -> None:
        """Things that may not share a volume, looked at over [before, now]."""
        if self.camera != "parked" and self.mandrel is not None:
            self.damage("the mandrel hit the camera's arm")
        if self.camera != "parked":
            jack = self.motion["jack"]
            if max(jack.position(before), jack.position(self.now)) > self.bench.camera_clear_height_mm:
                self.damage("the shaft hit the camera's arm")
        table, feed = self.motion["gun_table"], self.motion["gun_feed"]
        if table.moving(before):
            span = np.linspace(before, self.now, 9)
            out = feed.positions(span) > self.bench.gun_clear_feed_mm
            if np.any(out & (np.abs(table.velocities(span)) > 0.0)):
                self.damage("the guns turned into the nuts")

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` whenever a motion changes; returns what ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def start_move(self, axis: str, target: float, *, speed: float, acceleration: float, now: float) -> Trajectory:
        """Start a profile; returns it."""
        self.advance(now)
        return self._changed(self.motion[axis].move(target, speed, acceleration, now))

    def stop(self, axis: str, acceleration: float, now: float) -> Trajectory:
        """Quick stop and brake; returns the stopping trajectory."""
        self.advance(now)
        motion = self.motion[axis]
        speed = motion.velocity(now)
        trajectory = motion.stop(acceleration, now, self.numbers.properties.brake_delay_s)
        if axis == "jack" and self._reaches(trajectory.target):
            dock = self.dock()
            curve = self.engagement.curve(dock, trajectory.target)
            self.engagement.stopped(curve, motion, dock, speed, acceleration, now)
        return self._changed(trajectory)

    def cut_power(self, axis: str, acceleration: float, now: float) -> Trajectory:
        """Safe stop 1: the drive stops and the brake closes before the torque goes. A late brake lets the jack fall."""
        self.stop(axis, acceleration, now)
        late_s = self.numbers.properties.brake_late_s
        if axis != "jack" or late_s <= 0.0:
            return self.motion[axis].now_at
        self.damage("the load was dropped")
        return self._changed(self.motion[axis].drop(GRAVITY_MM_S2, late_s, 0.0, now))

    def _changed(self, trajectory: Trajectory) -> Trajectory:
        for listener in tuple(self._listeners):
            listener()
        return trajectory

    # ------------------------------------------------------------ poses

    def motors(self, now: float | None = None) -> Motors:
        """Motor positions of the shaft's axes at `now` (default: the last `advance`)."""
        at = self.now if now is None else now
        x, y, z, theta = (self.motion[name] for name in AXES[:4])
        return Motors(
            x.position(at), y.position(at), z.position(at), theta.position(at), (x.direction, y.direction, z.direction)
        )

    def dock(self) -> Dock:
        """What decides the contact now."""
        return Dock(
            geometry=self.geometry,
            bench=self.bench,
            properties=self.numbers.properties,
            rotor=self.rotor,
            shaft=self.shaft,
            cell=self.cell,
            motors=self.motors(),
            slip_deg=self.slip_deg,
            interference_mm=self.thermal.interference_mm,
            circle_growth=self.thermal.circle_growth,
            clamped=self.chuck_clamped,
            clamp_force_n=self._clamp_n(),
        )

    def _clamp_n(self) -> float:
        """Pull of the nuts on the column; beyond what closes the joint it makes no difference."""
        pull = float(self.joints.preload_n().sum())
        return min(pull, CLOSED_N) if pull > 0.0 else 0.0

    def T_cell_shaft(self) -> Array:
        """(4, 4) true pose of the shaft: lifted no further than contact lets it."""
        dock = self.dock()
        pose = dock.T_cell_shaft(dock.true_mm(np.array([dock.motors.z_mm])))[0]
        if self._reaches(dock.motors.z_mm):
            free_mm = self.engagement.near(dock, dock.motors.z_mm).gap_at(dock.motors.z_mm)
            pose[2, 3] = self.bench.rotor_face_mm - min(free_mm, self._gripped_mm)
        return np.asarray(pose)

    def T_cell_rotor(self) -> Array:
        """(4, 4) true pose of the rotor (z down)."""
        return self.rotor.T_cell_rotor

    def T_cell_camera(self, view: Literal["rotor", "shaft"]) -> Array:
        """(4, 4) true pose of the scanner in `view`."""
        return self.cell.T_cell_camera_rotor if view == "rotor" else self.cell.T_cell_camera_shaft

    def gap_mm(self) -> float:
        """True mean distance of the faces along z, mm, >= 0."""
        jack = self.motion["jack"].position(self.now)
        if not self._reaches(jack):
            dock = self.dock()
            return self.bench.rotor_face_mm - float(dock.T_cell_shaft(dock.true_mm(np.array([jack])))[0, 2, 3])
        return self._held(self.engagement.near(self.dock(), jack).gap_at(jack))

    def gap_at(self, x_mm: float, y_mm: float) -> float:
        """True distance of the faces along z at cell coordinates (x, y), mm; touching faces align themselves."""
        pose = self.T_cell_shaft()
        normal, point = pose[:3, 2], pose[:3, 3]
        mean = max(self.bench.rotor_face_mm - float(point[2]), 0.0)
        rise = float((x_mm - point[0]) * normal[0] + (y_mm - point[1]) * normal[1]) / float(normal[2])
        return max(mean + self.dock().faces().share_of_tilt(mean) * rise, 0.0)

    def probe_mm(self, number: int) -> float | None:
        """What gap probe 0, 1 or 2 on its bracket is away from the mandrel; None while the probes are at the joint."""
        if self.mandrel is None:
            return None
        return self.mandrel.probe_mm(number, self._mandrel_mm(self.mandrel) - self._bracket_mm)

    def _mandrel_mm(self, mandrel: Mandrel) -> Array:
        """(2,) where its axis passes the height of the probes; the bracket was set up round it."""
        dock = self.dock()
        height = dock.true_mm(np.array([dock.motors.z_mm]))
        return mandrel.axis_at(T_cell_table(self.cell, dock.motors, height, self.bench.jack_stroke_mm)[0])

    # ------------------------------------------------------------ forces

    def jack_force_n(self, time_s: Array) -> Array:
        """Axial force (k,) on the jack's sensor at times (k,) under the motion that is now under way, newton.

        m (g + a) + guide friction + contact; the shaft never pulls the sensor up.
        """
        jack = self.motion["jack"]
        z, velocity = jack.positions(time_s), jack.velocities(time_s)
        weight = self.shaft.mass_kg * (GRAVITY_MM_S2 + jack.accelerations(time_s)) * 1e-3
        way = np.where(velocity == 0.0, jack.direction, np.sign(velocity))
        constant, varying, phase = self.cell.guide_friction_n
        friction = way * (constant + varying * np.sin(2.0 * math.pi * z / GUIDE_PITCH_MM + phase))
        if not self._reaches(float(z.max())):
            return np.asarray(weight + friction)
        dock = self.dock()
        still = float(z.max()) == float(z.min())
        curve = self.engagement.near(dock, float(z[0])) if still else self.engagement.curve(dock, float(z.min()))
        swing = self.engagement.ring.at(time_s) if self.engagement.ring else 0.0
        contact = np.where(way > 0.0, curve.force_n(z + swing, inwards=True), curve.force_n(z + swing, inwards=False))
        return np.asarray(np.maximum(weight + contact, 0.0) + friction)

    def closing_resistance_n(self) -> float:
        """Axial force that closes the joint against press fit and tilt, newton."""
        return closing_resistance_n(self.dock())

    # ------------------------------------------------------------ chuck

    def set_chuck(self, *, clamped: bool) -> None:
        """Clamp or open the chuck."""
        self.chuck_clamped = clamped

    def set_tools(self, *, enabled: bool) -> None:
        """Let the guns turn, or stop them where they are."""
        self.tools_enabled = enabled
        for listener in self._tool_listeners:
            listener()

    def on_tools(self, listener: Callable[[], None]) -> None:
        """Call `listener` whenever the guns are let turn or stopped."""
        self._tool_listeners.append(listener)

    def turn_shaft(self, angle_deg: float) -> None:
        """Turn the shaft in its chuck about the table's axis."""
        self.slip_deg += angle_deg
