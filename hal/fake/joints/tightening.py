"""A gun's run on a nut: traces of torque over angle over time, stop conditions, verdict from windows. Pure.

The spindle turns at constant speed; between it and the nut lies the wind-up of tool and socket, so that spindle angle
= nut rotation + torque / stiffness. The controller looks at each sample and stops the spindle one sample later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.fake.joints.curve import Curve
from hal.interfaces import Band, TighteningProgram, Trace

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GunProperties:
    """The spindle and its controller."""

    sample_s: float = 1e-3
    windup_nm_per_deg: float = 6.0
    noise: float = 0.001
    """Of the torque."""
    noise_nm: float = 0.005
    memory_s: float = 3.0
    """Trace kept before the stop, at least from the threshold torque on."""
    drop: float = 0.3
    """Torque below this share of its peak, once the threshold was reached, ends the run."""
    idle_s: float = 0.05
    """Start and stop of the controller."""


@dataclass(frozen=True, slots=True)
class Run:
    """What one run does from its start on. Angles are magnitudes, in the sense of the run."""

    curve: Curve
    spindle_deg: Array
    """(n,) spindle angle at the curve's knots."""
    speed_deg_s: float
    duration_s: float
    trace: Trace
    reason: str
    """What stopped it: torque, angle, timeout, drop."""

    def at(self, time_s: float) -> tuple[float, float, float]:
        """(spindle angle, rotation of the nut, preload) after `time_s`."""
        spindle = self.speed_deg_s * min(max(time_s, 0.0), self.duration_s)
        rotation = float(np.interp(spindle, self.spindle_deg, self.curve.rotation_deg))
        return spindle, rotation, float(np.interp(spindle, self.spindle_deg, self.curve.preload_n))

    @property
    def peak_torque_nm(self) -> float:
        """Largest torque of the trace."""
        return float(np.max(self.trace.torque_nm))


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Verdict of one trace against its windows."""

    ok: bool
    torque_nm: float
    angle_deg: float
    torque_band: Band
    angle_band: Band


def band(value: float, low: float, high: float) -> Band:
    """Where `value` lies; what is not a number is low."""
    if value > high:
        return Band.HIGH
    return Band.OK if value >= low else Band.LOW


def evaluate(trace: Trace, program: TighteningProgram) -> Evaluation:
    """Recompute the verdict: torque is the trace's maximum, angle runs from the threshold torque to the shut-off.

    Shut-off is the last sample at the target torque or, where that was not reached, the end of the trace.
    """
    torque, angle = trace.torque_nm, trace.angle_deg
    above = np.flatnonzero(torque >= program.threshold_torque_nm)
    at_target = np.flatnonzero(torque >= program.target_torque_nm)
    end = int(at_target[-1]) if len(at_target) else len(torque) - 1
    turned = float(angle[end] - angle[above[0]]) if len(above) else 0.0
    peak = float(np.max(torque))
    torque_band = band(peak, program.torque_low_nm, program.torque_high_nm)
    angle_band = band(turned, program.angle_low_deg, program.angle_high_deg)
    return Evaluation(torque_band == angle_band == Band.OK, peak, turned, torque_band, angle_band)


def first_crossing(x: Array, y: Array, level: float) -> float:
    """First x at which the straight pieces (x, y) reach `level` from below; infinite if never."""
    if y[0] >= level:
        return float(x[0])
    above = np.flatnonzero(y >= level)
    if not len(above):
        return float("inf")
    k = int(above[0])
    return float(x[k - 1] + (level - y[k - 1]) / (y[k] - y[k - 1]) * (x[k] - x[k - 1]))


def slipping(curve: Curve, torque_nm: float) -> Curve:
    """The socket leaves the nut once `torque_nm` is met: from there on the spindle turns alone."""
    place = first_crossing(np.arange(len(curve.torque_nm), dtype=np.float64), curve.torque_nm, torque_nm)
    if not np.isfinite(place):
        return curve
    k = int(np.ceil(place))
    share = place - (k - 1)
    rotation, preload = (
        float(v[k - 1] + share * (v[k] - v[k - 1])) if k else float(v[0]) for v in (curve.rotation_deg, curve.preload_n)
    )
    # The nut stays; a hair of rotation over the rest of the spindle's way keeps the pieces ascending.
    return Curve(
        np.concatenate([curve.rotation_deg[:k], [rotation, rotation + 1e-6, rotation + 1e9]]),
        np.concatenate([curve.torque_nm[:k], [torque_nm, 0.0, 0.0]]),
        np.concatenate([curve.preload_n[:k], [preload, preload, preload]]),
    )


def drive(
    curve: Curve, program: TighteningProgram, gun: GunProperties, rng: np.random.Generator, *, target: bool = True
) -> Run:
    """Run `program` over `curve`. Without `target` (loosening) only angle, counted from the start, and time stop it."""
    spindle = np.maximum.accumulate(curve.rotation_deg + curve.torque_nm / gun.windup_nm_per_deg)
    speed = 6.0 * program.speed_rpm
    threshold_deg = first_crossing(spindle, curve.torque_nm, program.threshold_torque_nm) if target else 0.0
    limits = {
        "torque": first_crossing(spindle, curve.torque_nm, program.target_torque_nm) if target else float("inf"),
        "angle": threshold_deg + program.angle_high_deg + speed * gun.sample_s,
        "timeout": speed * program.timeout_s,
    }
    reason = min(limits, key=limits.__getitem__)
    stop_s = limits[reason] / speed
    begin_s = max(0.0, min(stop_s - gun.memory_s, threshold_deg / speed - 0.2))
    first = int(begin_s / gun.sample_s)
    count = int(stop_s / gun.sample_s) + (20 if reason == "torque" else 1) - first
    time_s = np.asarray((first + np.arange(count + 1)) * gun.sample_s, dtype=np.float64)
    angle = np.asarray(speed * time_s, dtype=np.float64)
    noise = rng.standard_normal((2, len(angle)))
    true = np.interp(angle, spindle, curve.torque_nm)
    torque = np.asarray(true * (1.0 + gun.noise * noise[0]) + gun.noise_nm * noise[1], dtype=np.float64)
    end, reason = _stop(torque, program, gun, reason, target)
    trace = Trace(time_s[:end] - time_s[0], angle[:end], torque[:end])
    return Run(curve, spindle, speed, float(time_s[end - 1]), trace, reason)


def _stop(torque: Array, program: TighteningProgram, gun: GunProperties, reason: str, target: bool) -> tuple[int, str]:
    """(samples kept, what stopped the run) as the controller sees the samples."""
    ends = [(len(torque), reason)]
    if target:
        reached = np.flatnonzero(torque >= program.target_torque_nm)
        if len(reached):
            ends.append((int(reached[0]) + 2, "torque"))
        peak = np.maximum.accumulate(torque)
        dropped = np.flatnonzero((peak >= program.threshold_torque_nm) & (torque < gun.drop * peak))
        if len(dropped):
            ends.append((int(dropped[0]) + 1, "drop"))
    end, reason = min(ends)
    return min(end, len(torque)), reason


def turned(curve: Curve, angle_deg: float, limit_nm: float, gun: GunProperties) -> tuple[float, float, float, float]:
    """A slow turn by up to `angle_deg` (magnitude): (spindle angle, nut rotation, preload, largest torque)."""
    spindle = np.maximum.accumulate(curve.rotation_deg + curve.torque_nm / gun.windup_nm_per_deg)
    end = min(angle_deg, first_crossing(spindle, curve.torque_nm, limit_nm))
    rotation = float(np.interp(end, spindle, curve.rotation_deg))
    met = curve.torque_nm[spindle <= end]
    peak = max(float(np.interp(end, spindle, curve.torque_nm)), float(np.max(met)) if len(met) else 0.0)
    return end, rotation, float(np.interp(end, spindle, curve.preload_n)), min(peak, limit_nm)
