"""True motion of one axis: trapezoidal profiles, quick stop, brake. Evaluated at a time, never ticked.

Positions here are the motor's, which is what the encoder reads; `hal.fake.stack` turns them into true poses with
backlash, scale and encoder error. Units are the axis' own (mm or deg) and seconds.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CLOCK_S = 1e-6
"""Two times closer than this are the same: a loop's timer may fire a rounding error early."""
REMEMBERED = 8
"""Trajectories kept: a sensor's delay reaches back by milliseconds."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Pieces of constant acceleration: piece k starts at `times[k]` in (position, velocity, acceleration)[k]."""

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array
    starts: tuple[float, ...] = field(init=False)
    """`times` for looking up one."""
    pieces: tuple[tuple[float, float, float, float], ...] = field(init=False)
    """Time, position, velocity and acceleration of each, likewise."""

    def __post_init__(self) -> None:
        columns = (self.times, self.positions, self.velocities, self.accelerations)
        pieces = tuple(zip(*(column.tolist() for column in columns), strict=True))
        object.__setattr__(self, "starts", tuple(self.times.tolist()))
        object.__setattr__(self, "pieces", pieces)

    def _piece(self, time_s: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        time = np.asarray(time_s, dtype=np.float64)
        piece = np.maximum(np.searchsorted(self.times, time, side="right") - 1, 0)
        return piece, np.maximum(time - self.times[piece], 0.0)

    def position_at(self, time_s: ArrayLike) -> Array:
        """Position, same shape as `time_s`."""
        piece, dt = self._piece(time_s)
        value = self.positions[piece] + dt * (self.velocities[piece] + 0.5 * dt * self.accelerations[piece])
        return np.asarray(value)

    def velocity_at(self, time_s: ArrayLike) -> Array:
        """Velocity per second, same shape as `time_s`."""
        piece, dt = self._piece(time_s)
        return np.asarray(self.velocities[piece] + dt * self.accelerations[piece])

    def acceleration_at(self, time_s: ArrayLike) -> Array:
        """Acceleration per second squared, same shape as `time_s`."""
        return np.asarray(self.accelerations[self._piece(time_s)[0]])

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Position, velocity and acceleration at one time."""
        begin_s, x, v, a = self.pieces[max(bisect_right(self.starts, time_s) - 1, 0)]
        dt = max(time_s - begin_s, 0.0)
        return x + dt * (v + 0.5 * dt * a), v + dt * a, a

    @property
    def end_s(self) -> float:
        """When it stands for good."""
        return self.starts[-1]

    @property
    def target(self) -> float:
        """Where it ends."""
        return float(self.positions[-1])


def standing(position: float, now: float) -> Trajectory:
    """At rest at `position` since `now`."""
    return _pieces([(now, position, 0.0, 0.0)])


def trapezoid(start: float, target: float, speed: float, acceleration: float, now: float) -> Trajectory:
    """From rest at `start` to rest at `target`. `speed` and `acceleration` are magnitudes > 0."""
    distance = abs(target - start)
    if distance == 0.0:
        return standing(target, now)
    sign = math.copysign(1.0, target - start)
    peak = min(speed, math.sqrt(acceleration * distance))
    ramp_s, ramp = peak / acceleration, 0.5 * peak * peak / acceleration
    cruise_s = (distance - 2.0 * ramp) / peak
    v, a = sign * peak, sign * acceleration
    return _pieces(
        [
            (now, start, 0.0, a),
            (now + ramp_s, start + sign * ramp, v, 0.0),
            (now + ramp_s + cruise_s, target - sign * ramp, v, -a),
            (now + 2.0 * ramp_s + cruise_s, target, 0.0, 0.0),
        ]
    )


def stopping(position: float, velocity: float, acceleration: float, now: float) -> Trajectory:
    """Quick stop from (`position`, `velocity`) with the magnitude `acceleration`."""
    if velocity == 0.0:
        return standing(position, now)
    stop_s = abs(velocity) / acceleration
    end = position + 0.5 * velocity * stop_s
    return _pieces([(now, position, velocity, -math.copysign(acceleration, velocity)), (now + stop_s, end, 0.0, 0.0)])


def dropping(stop: Trajectory, gravity: float, seconds: float, floor: float) -> Trajectory:
    """`stop`, then free fall with `gravity` (magnitude) for `seconds` until the late brake holds, or to `floor`."""
    start, now = stop.target, stop.end_s
    seconds = min(seconds, math.sqrt(2.0 * max(start - floor, 0.0) / gravity))
    if seconds <= 0.0:
        return stop
    end = start - 0.5 * gravity * seconds * seconds
    fall = _pieces([(now, start, 0.0, -gravity), (now + seconds, end, 0.0, 0.0)])
    before = stop.times < now
    return Trajectory(
        np.append(stop.times[before], fall.times),
        np.append(stop.positions[before], fall.positions),
        np.append(stop.velocities[before], fall.velocities),
        np.append(stop.accelerations[before], fall.accelerations),
    )


def _pieces(rows: list[tuple[float, float, float, float]]) -> Trajectory:
    time, position, velocity, acceleration = np.array(rows, dtype=np.float64).T
    return Trajectory(time, position, velocity, acceleration)


class AxisMotion:
    """The motor of one axis and the drive's own state, which live as long as the plant does.

    `direction` is the sign of the last motion: backlash and friction remember it. `version` grows with each change.
    """

    def __init__(self, position: float = 0.0, now: float = 0.0) -> None:
        self.now_at = standing(position, now)
        self._past: deque[tuple[float, Trajectory]] = deque(maxlen=REMEMBERED)
        self._changed_s = now
        self.direction = 1.0
        self.version = 0
        self.homed = False
        self.enabled = True
        self.brake_closes_s = now

    def start(self, trajectory: Trajectory, now: float) -> None:
        """Replace what the axis does from `now` on."""
        self._past.append((now, self.now_at))
        self._changed_s = now
        self.now_at = trajectory
        velocity = trajectory.target - float(trajectory.position_at(now))
        if velocity != 0.0:
            self.direction = math.copysign(1.0, velocity)
        self.version += 1

    def move(self, target: float, speed: float, acceleration: float, now: float) -> Trajectory:
        """Profile to `target` from where the axis stands at `now` (a moving axis is stopped at its present place)."""
        self.start(trapezoid(self.position(now), target, speed, acceleration, now), now)
        self.brake_closes_s = math.inf
        return self.now_at

    def stop(self, acceleration: float, now: float, brake_delay_s: float) -> Trajectory:
        """Quick stop; the brake is closed `brake_delay_s` after standstill."""
        if self.moving(now):
            self.start(stopping(self.position(now), self.velocity(now), acceleration, now), now)
        if math.isinf(self.brake_closes_s):
            self.brake_closes_s = self.now_at.end_s + brake_delay_s
        return self.now_at

    def drop(self, gravity: float, seconds: float, floor: float, now: float) -> Trajectory:
        """After the present stop the drive has no torque, and the brake closes `seconds` late."""
        self.start(
            dropping(self.now_at if self.moving(now) else standing(self.position(now), now), gravity, seconds, floor),
            now,
        )
        self.brake_closes_s = self.now_at.end_s
        return self.now_at

    def position(self, now: float) -> float:
        """Motor position at `now`."""
        return self._then(now).at(now)[0]

    def velocity(self, now: float) -> float:
        """Motor velocity at `now`."""
        return self._then(now).at(now)[1]

    def _then(self, now: float) -> Trajectory:
        found = self.now_at
        if now < self._changed_s:
            for until, trajectory in reversed(self._past):
                if now < until:
                    found = trajectory
        return found

    def moving(self, now: float) -> bool:
        """Whether the profile is still running at `now`."""
        return now < self.now_at.end_s - CLOCK_S

    def positions(self, time_s: Array) -> Array:
        """Motor positions (k,) at times (k,), the last trajectories before the present one included."""
        return self._over(time_s, Trajectory.position_at)

    def velocities(self, time_s: Array) -> Array:
        """Motor velocities (k,)."""
        return self._over(time_s, Trajectory.velocity_at)

    def accelerations(self, time_s: Array) -> Array:
        """Motor accelerations (k,)."""
        return self._over(time_s, Trajectory.acceleration_at)

    def _over(self, time_s: Array, what: Callable[[Trajectory, Array], Array]) -> Array:
        values = what(self.now_at, time_s)
        if time_s.size == 0 or time_s.min() >= self._changed_s:
            return values
        for until, trajectory in reversed(self._past):
            values = np.where(time_s < until, what(trajectory, time_s), values)
        return values
