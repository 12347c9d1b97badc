"""What the guard process decides, and in which order it acts; no sockets, no timers: each call says what time it is.

On a trip the gate latches, the drives are told to stop, and only then is anybody else told. A trip is latched until the
controller clears it by its number.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hal.codec.lawicel import CanFrame
from hal.guard.gate import Gate
from hal.guard.logic import Trip, Watch, check, overdue
from hal.interfaces import ForceBlock, GuardLimits, GuardState

NO_LIMITS = GuardLimits("idle", tare_n=0.0, trip_n=math.inf, low_n=-math.inf, stale_ms=math.inf, block=1)


class Sentry:
    """`stop` sends a quick stop to every drive; `tell` tells the controller what there is to know.

    A controller that is not heard is dead: after `beat_s` while armed, which is a trip; after `quiet_s` at other times,
    when the drives' heartbeat is withheld. Drives that got none for `consumer_s` stop by themselves, and what stopped
    by itself must not be started by a frame that was still under way: from then on the gate is latched, too.
    """

    def __init__(
        self,
        stop: Callable[[], None],
        tell: Callable[[], None],
        *,
        beat_s: float,
        quiet_s: float,
        consumer_s: float,
        frozen_samples: int = 0,
    ) -> None:
        self.gate = Gate()
        self.trip: Trip | None = Trip("not re-armed since the guard started")
        self.armed = False
        self.proven = False
        """Whether a sample was looked at since `arm`."""
        self._stop, self._tell = stop, tell
        self._beat_limit_s, self._quiet_s, self._consumer_s = beat_s, quiet_s, consumer_s
        self._watch = Watch(NO_LIMITS, frozen_samples)
        self._armed_s = 0.0
        self._newest_s = self._beat_s = self._sent_s = -math.inf

    def state(self, now: float) -> GuardState:
        """What it knows."""
        watch, trip = self._watch, self.trip
        reason = trip.reason if trip else ""
        return GuardState(self.armed, trip is not None, reason, watch.peak_n, watch.last_n, watch.samples, now)

    # ------------------------------------------------------------ what comes

    def samples(self, block: ForceBlock, now: float) -> None:
        """Samples without a gap, as they come; those taken before arming are not looked at."""
        newest_s = block.time_s + (len(block.samples_n) - 1) * block.period_s
        if self.armed and newest_s >= self._armed_s:
            self._watch, trip = check(self._watch, block, now)
            if trip is not None:
                self.latch(trip)
            elif not self.proven:
                self.proven = True
                self._tell()
        self._newest_s = newest_s

    def beat(self, now: float) -> None:
        """The controller lives."""
        self._beat_s = now

    def gone(self) -> None:
        """The controller's connection has ended."""
        self._beat_s = -math.inf
        self.latch(Trip("the controller's connection ended"))

    def passes(self, frame: CanFrame, epoch: int, now: float) -> bool:
        """Whether a frame of the controller may go to the drives."""
        self._heartbeats(now)
        return self.gate.passes(frame, epoch)

    # ------------------------------------------------------------ what the controller asks

    def arm(self, limits: GuardLimits, now: float) -> None:
        """Watch under `limits` from now on, unless a trip is latched."""
        self.look(now)
        if self.trip is None:
            self._watch = Watch(limits, self._watch.frozen_samples)
            self.armed, self.proven, self._armed_s = True, False, now

    def disarm(self) -> None:
        """Watch no longer."""
        self.armed = False

    def clear(self, epoch: int, now: float) -> str:
        """Open the gate for a controller that knows of trip `epoch`; the reason where that cannot be, or empty."""
        if now - self._sent_s > self._consumer_s:
            return "the drives get no heartbeat"
        if not self.gate.clear(epoch):
            reason = self.trip.reason if self.trip else "another controller"
            return f"tripped again meanwhile: {reason}"
        self.trip, self.armed = None, False
        return ""

    # ------------------------------------------------------------ what time brings

    def due_s(self) -> float:
        """When `look` has something to do, as far as is known now."""
        if not self.armed:
            return math.inf
        stale_s = self._watch.limits.stale_ms * 1e-3
        return min(max(self._newest_s, self._armed_s) + stale_s, self._beat_s + self._beat_limit_s)

    def look(self, now: float) -> None:
        """Trip where something is overdue."""
        self._heartbeats(now)
        if self.armed:
            newest_s = max(self._newest_s, self._armed_s)
            trip = overdue(self._watch, newest_s, self._beat_s, self._beat_limit_s, now)
            if trip is not None:
                self.latch(trip)

    def heartbeat_due(self, now: float) -> bool:
        """Whether the drives may be told that the controller lives."""
        self.look(now)
        return now - self._beat_s <= self._quiet_s

    def heartbeat_sent(self, now: float) -> None:
        """They were told."""
        self._sent_s = now

    def _heartbeats(self, now: float) -> None:
        if not self.gate.latched and (silent_s := now - self._sent_s) > self._consumer_s:
            self.latch(Trip(f"no heartbeat went to the drives for {silent_s * 1e3:.0f} ms: they stop by themselves"))

    def latch(self, trip: Trip) -> None:
        """Nothing moves from here on. The first reason stays."""
        if self.gate.latched:
            return
        self.gate.latch()
        self._stop()
        self.trip, self.armed = trip, False
        self._tell()
