"""The plant: one physical truth behind every fake. Actuators write into it, sensors and camera read from it.

How a fake uses it (always `advance` first; time is the event loop's)::

    plant.advance(now)
    plant.start_move("jack", 380.0, speed=10.0, acceleration=50.0, now=now); plant.stop("jack", 50.0, now)
    plant.motion["gun_table"].position(now)          # motor position = what an encoder reads, mm or deg
    plant.T_cell_shaft(), T_cell_rotor(), T_cell_camera("rotor" | "shaft")     # true poses at the last `advance`
    plant.gap_mm(), plant.gap_at(x_mm, y_mm)          # true distance of the faces along z, >= 0
    plant.rotor, plant.shaft, plant.cell              # RotorTruth, ShaftTruth, CellTruth (features, axes errors)
    plant.load_parts("R-1", "S-1")                    # other parts, drawn from seed and serial numbers
    plant.set_chuck(clamped=True), plant.turn_shaft(0.01)      # shaft turned in its chuck by reaction torque, deg
    plant.camera = "parked" | "rotor" | "shaft" | "moving"     # where the camera's arm is
    plant.thermal, plant.joints                       # slots, see `ThermalTruth` and `JointsTruth`
    plant.numbers.imperfections, plant.numbers.properties      # every number, overrides applied
    plant.rng("gun_a", "friction")                    # generator of your own, same for the same names
    plant.damage("what")                              # something was hit or overloaded: the joint is not good
    plant.subscribe(callback) -> unsubscribe          # called whenever a motion changes

The controller never sees any of this; `hal.fake.truth.truth_of` is the one door by which truth leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.fake.frames import child_rng, small_pose
from hal.fake.geometry import BenchGeometry, JointGeometry
from hal.fake.levels import Level, TwinNumbers, numbers
from hal.fake.motion import AxisMotion, Trajectory
from hal.fake.parts import RotorTruth, ShaftTruth, draw_cell, draw_rotor, draw_shaft
from hal.fake.stack import Motors, T_cell_table, true_linear_mm

Array = NDArray[np.float64]
CameraPlace = Literal["parked", "rotor", "shaft", "moving"]
AXES = ("stage_x", "stage_y", "jack", "shaft_table", "gun_table", "gun_feed")


class ThermalTruth(Protocol):
    """Temperatures of the two members of the spigot, degrees Celsius."""

    @property
    def shaft_c(self) -> float: ...
    @property
    def rotor_c(self) -> float: ...
    def advance(self, now: float, gap_mm: float) -> None:
        """Integrate to `now`; `gap_mm` is the present distance of the faces (the spigot engages below its length)."""
        ...


class JointsTruth(Protocol):
    """The nuts."""

    def preload_n(self) -> Array:
        """(n,) present preload of each stud."""
        ...

    def yielded(self) -> NDArray[np.bool_]:
        """(n,) studs beyond yield, or threads stripped."""
        ...


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """`[twin]` of the cell file."""

    seed: int = 1
    level: Level = "nominal"
    overrides: Mapping[str, float] = field(default_factory=dict)


class Isothermal:
    """Both members at one temperature: a bench without a heater."""

    def __init__(self, temperature_c: float) -> None:
        self.shaft_c = temperature_c
        self.rotor_c = temperature_c

    def advance(self, now: float, gap_mm: float) -> None:
        """Nothing changes."""


class Loose:
    """Studs without nuts."""

    def __init__(self, count: int) -> None:
        self._count = count

    def preload_n(self) -> Array:
        """(n,) zeros."""
        return np.zeros(self._count)

    def yielded(self) -> NDArray[np.bool_]:
        """(n,) false."""
        return np.zeros(self._count, dtype=bool)


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
        self.thermal: ThermalTruth = Isothermal(self.numbers.properties.ambient_c)
        self.joints: JointsTruth = Loose(geometry.count)
        self.damages: list[str] = []
        self._listeners: list[Callable[[], None]] = []
        self.rotor: RotorTruth
        self.shaft: ShaftTruth
        self.load_parts("rotor-0", "shaft-0")

    # ------------------------------------------------------------ parts and random children

    def rng(self, *names: str) -> np.random.Generator:
        """Generator of its own for `names`, from the twin's seed."""
        return child_rng(self.settings.seed, *names)

    def load_parts(self, rotor_serial: str, shaft_serial: str) -> None:
        """Put another rotor and shaft in: same serial numbers, same parts."""
        seed = self.settings.seed
        self.rotor = draw_rotor(self.geometry, self.bench, self.numbers, seed, rotor_serial)
        self.shaft = draw_shaft(self.geometry, self.numbers, seed, shaft_serial)
        self.slip_deg = 0.0
        self.loaded_s = self.now

    def damage(self, what: str) -> None:
        """Note once that something was hit or overloaded."""
        if what not in self.damages:
            self.damages.append(what)

    # ------------------------------------------------------------ time and motion

    def advance(self, now: float) -> None:
        """Integrate up to `now`; earlier times are ignored."""
        if now <= self.now:
            return
        self.thermal.advance(now, self.gap_mm())
        self.now = now

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
        return self._changed(self.motion[axis].stop(acceleration, now, self.numbers.properties.brake_delay_s))

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

    def T_cell_shaft(self) -> Array:
        """(4, 4) true pose of the shaft."""
        at = self.motors()
        z = true_linear_mm(self.cell, 2, np.array(at.z_mm), at.directions[2])
        slip = small_pose(np.zeros(3), np.array([0.0, 0.0, self.slip_deg]))
        table = T_cell_table(self.cell, at, z, self.bench.jack_stroke_mm)
        return np.asarray(table @ slip @ self.shaft.T_chuck_shaft)

    def T_cell_rotor(self) -> Array:
        """(4, 4) true pose of the rotor (z down)."""
        return self.rotor.T_cell_rotor

    def T_cell_camera(self, view: Literal["rotor", "shaft"]) -> Array:
        """(4, 4) true pose of the scanner in `view`."""
        return self.cell.T_cell_camera_rotor if view == "rotor" else self.cell.T_cell_camera_shaft

    def gap_mm(self) -> float:
        """True distance of the faces at the joint's centre along z, mm."""
        return self.gap_at(0.0, 0.0)

    def gap_at(self, x_mm: float, y_mm: float) -> float:
        """True distance of the faces along z at cell coordinates (x, y), mm."""
        pose = self.T_cell_shaft()
        normal, point = pose[:3, 2], pose[:3, 3]
        height = point[2] - ((x_mm - point[0]) * normal[0] + (y_mm - point[1]) * normal[1]) / normal[2]
        return max(self.bench.rotor_face_mm - float(height), 0.0)

    # ------------------------------------------------------------ chuck

    def set_chuck(self, *, clamped: bool) -> None:
        """Clamp or open the chuck."""
        self.chuck_clamped = clamped

    def turn_shaft(self, angle_deg: float) -> None:
        """Turn the shaft in its chuck about the table's axis."""
        self.slip_deg += angle_deg
