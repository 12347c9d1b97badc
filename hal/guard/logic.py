"""The guard's decision, pure: samples in, trip out.

The same function decides in the loop and in a process of its own. It keeps no state but the frozen `Watch` that it is
given and gives back; latching is its owner's: a trip is final until an explicit re-arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hal.interfaces import ForceBlock, GuardLimits


@dataclass(frozen=True, slots=True)
class Trip:
    """Why the guard must stop the axes; `force_n` is the net force that did it, NaN where it was not force."""

    reason: str
    force_n: float = math.nan


@dataclass(frozen=True, slots=True)
class Watch:
    """What the guard has seen since the last arm: net forces, newton; `next_sequence` is None before a first block.

    `equal` samples in a row up to the last one had the same value; `frozen_samples` of them trip (0: never).
    """

    limits: GuardLimits
    frozen_samples: int = 0
    next_sequence: int | None = None
    peak_n: float = 0.0
    last_n: float = 0.0
    samples: int = 0
    equal: int = 0


def check(watch: Watch, block: ForceBlock, now: float) -> tuple[Watch, Trip | None]:
    """The watch after `block`, looked at at loop time `now`, and the trip that it demands, if any.

    Trips, first one counts: no samples; samples missing in between; not a number; net force above `trip_n` or below
    `low_n`; newest sample older than `stale_ms`, or from the future by more than one sample; a frozen signal.
    """
    limits, count = watch.limits, len(block.samples_n)
    if count == 0:
        return watch, Trip(f"{limits.label}: the sensor delivered no samples")
    if watch.next_sequence is not None and block.sequence != watch.next_sequence:
        gap = f"sample {watch.next_sequence} expected, {block.sequence} came"
        return watch, Trip(f"{limits.label}: the force sensor's samples have a gap: {gap}")
    low_n, high_n = float(block.samples_n.min()) - limits.tare_n, float(block.samples_n.max()) - limits.tare_n
    seen = Watch(
        watch.limits,
        watch.frozen_samples,
        next_sequence=block.sequence + count,
        peak_n=max(watch.peak_n, high_n) if high_n == high_n else watch.peak_n,
        last_n=high_n if low_n == high_n else float(block.samples_n[-1]) - limits.tare_n,
        samples=watch.samples + count,
        equal=0 if low_n != high_n else count + (watch.equal if watch.last_n == high_n else 0),
    )
    if not (low_n >= limits.low_n and high_n <= limits.trip_n):
        return _seen_up_to(seen, watch, block), _force_trip(limits, block)
    age_s = now - (block.time_s + (count - 1) * block.period_s)
    if not age_s * 1e3 <= limits.stale_ms:
        return seen, Trip(
            f"{limits.label}: the newest sample is {age_s * 1e3:.1f} ms old (limit {limits.stale_ms:g} ms)"
        )
    if age_s < -block.period_s:
        return seen, Trip(f"{limits.label}: the newest sample is {-age_s * 1e3:.1f} ms in the future")
    if 0 < seen.frozen_samples <= seen.equal:
        return seen, Trip(f"{limits.label}: the signal is frozen at {seen.last_n:.2f} N for {seen.equal} samples")
    return seen, None


def overdue(watch: Watch, newest_s: float, beat_s: float, beat_limit_s: float, now: float) -> Trip | None:
    """The trip that is due at `now` because nothing came: no sample since the one of `newest_s`, or no sign of life of
    the controller, for longer than `beat_limit_s`, since `beat_s`."""
    limits = watch.limits
    if (age_ms := (now - newest_s) * 1e3) > limits.stale_ms:
        return Trip(f"{limits.label}: the force sensor is silent for {age_ms:.1f} ms (limit {limits.stale_ms:g} ms)")
    if (silent_s := now - beat_s) > beat_limit_s:
        silent, limit = silent_s * 1e3, beat_limit_s * 1e3
        return Trip(f"{limits.label}: the controller is not heard for {silent:.0f} ms (limit {limit:.0f} ms)")
    return None


def _force_trip(limits: GuardLimits, block: ForceBlock) -> Trip:
    """The first sample that is not within the limits, in words."""
    net = block.samples_n - limits.tare_n
    first = float(net[int(np.argmax(~((net >= limits.low_n) & (net <= limits.trip_n))))])
    if math.isnan(first):
        return Trip(f"{limits.label}: the force is not a number")
    limit, side = (limits.trip_n, "above") if first > limits.trip_n else (limits.low_n, "below")
    return Trip(f"{limits.label}: net force {first:.2f} N {side} {limit:.2f} N", first)


def _seen_up_to(seen: Watch, before: Watch, block: ForceBlock) -> Watch:
    """Peak over the numbers of a block that may hold NaN."""
    finite = block.samples_n[~np.isnan(block.samples_n)]
    peak_n = max(before.peak_n, float(finite.max()) - seen.limits.tare_n) if finite.size else before.peak_n
    return replace(seen, peak_n=peak_n)
