"""The force guard as a task of the controller's loop: sole reader of the jack's force sensor, under the pure logic.

It reads while it is armed or while somebody wants a window, and is no task at all otherwise. On a trip it latches
first (from then on no motion may start), halts every axis at once, each with its own deadline, ends commands that
were on their way to an axis, and halts those axes once more. Only `rearm` clears the latch.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hal.errors import GuardTripped, ImplausibleReading
from hal.guard.halting import halt_all
from hal.guard.logic import Trip, Watch, check
from hal.guard.silence import Silence
from hal.interfaces import Axis, ForceBlock, ForceSensor, GuardLimits, GuardState
from hal.latch import Latch

MOST_SKIPPED = 100
"""Blocks that a link may have kept from before the guard was armed; beyond them the sensor is stale."""
_NO_LIMITS = GuardLimits("idle", tare_n=0.0, trip_n=math.inf, low_n=-math.inf, stale_ms=math.inf, block=1)


@dataclass(slots=True)
class _Window:
    """Samples being gathered for one caller."""

    wanted: int
    since_s: float
    done: asyncio.Future[ForceBlock]
    first: ForceBlock | None = None
    parts: list[NDArray[np.float64]] = field(default_factory=list)

    def take(self, block: ForceBlock) -> None:
        """Add what is still wanted of `block`; samples taken before `since_s` are not."""
        old = max(0, math.ceil((self.since_s - block.time_s) / block.period_s - 1e-6))
        if self.done.done() or old >= len(block.samples_n):
            return
        samples = block.samples_n[old : old + self.wanted]
        if self.first is None:
            self.first = replace(block, sequence=block.sequence + old, time_s=block.time_s + old * block.period_s)
        self.parts.append(samples)
        self.wanted -= len(samples)
        if self.wanted <= 0:
            self.done.set_result(replace(self.first, samples_n=np.concatenate(self.parts)))


class InLoopGuard:
    """`hal.interfaces.ForceGuard`. `axes` are the bare axes, which it halts directly.

    `idle_block` is the number of samples that it reads in one go for a window while it is not armed, `idle_stale_s`
    how long it then waits for a late block, `halt_deadline_s` the time that one axis is given to acknowledge its halt,
    `frozen_samples` how many equal samples in a row no living sensor gives (0: any number).
    """

    def __init__(
        self,
        sensor: ForceSensor,
        axes: Sequence[Axis],
        latch: Latch,
        *,
        idle_block: int,
        idle_stale_s: float,
        halt_deadline_s: float,
        frozen_samples: int = 0,
    ) -> None:
        self._sensor = sensor
        self._axes = axes
        self._latch = latch
        self._idle_block = idle_block
        self._idle_stale_s = idle_stale_s
        self._halt_deadline_s = halt_deadline_s
        self._watch = Watch(_NO_LIMITS, frozen_samples)
        self._idle = self._watch
        self._armed = False
        self._armed_s = 0.0
        self._skipped = 0
        self._acting = False
        self._trip: Trip | None = None
        self._proven: asyncio.Future[None] | None = None
        self._windows: list[_Window] = []
        self._task: asyncio.Task[None] | None = None
        self._time_s = 0.0

    async def open(self) -> None:
        """It is here already."""

    @property
    def alive(self) -> bool:
        """Whether it does what it is there for. A guard whose reading broke off while it had to act does not."""
        task = self._task
        return task is None or not task.done() or task.cancelled() or task.exception() is None

    def state(self) -> GuardState:
        """What the guard knows now."""
        watch, trip = self._watch, self._trip
        return GuardState(
            armed=self._armed,
            tripped=trip is not None,
            reason=trip.reason if trip else "",
            peak_n=watch.peak_n,
            last_n=watch.last_n,
            samples=watch.samples,
            time_s=self._time_s,
        )

    async def arm(self, limits: GuardLimits) -> None:
        """Watch under `limits`; returns once a first block was looked at, so that no motion starts on a dead sensor.

        That block may trip; then motion is refused. Raises GuardTripped while an earlier trip is latched.
        """
        if self._trip is not None:
            raise GuardTripped(f"latched: {self._trip.reason}", force_n=self._trip.force_n)
        if not (limits.low_n < limits.trip_n and math.isfinite(limits.tare_n) and limits.block >= 1):
            raise ImplausibleReading(f"limits that nothing can keep: {limits}", device=self._sensor.name)
        self._watch = Watch(limits, self._watch.frozen_samples, self._watch.next_sequence)
        self._armed, self._armed_s, self._skipped = True, asyncio.get_running_loop().time(), 0
        self._proven = asyncio.get_running_loop().create_future()
        self._start()
        await self._proven

    async def disarm(self) -> GuardState:
        """Stop watching; returns once a trip's halts have been acknowledged or given up."""
        self._armed = False
        await self._settle()
        return self.state()

    async def rearm(self) -> None:
        """Clear the latch; motion may be asked for again."""
        await self._settle()
        if self._task is not None and self._task.done():
            self._task = None
        self._trip = None
        self._latch.open("guard")
        if self._armed:
            await self.arm(self._watch.limits)

    async def window(self, seconds: float) -> ForceBlock:
        """The samples of the next `seconds`, armed or not. Raises GuardTripped when the guard trips meanwhile."""
        wanted = max(1, round(seconds * self._sensor.rate_hz))
        loop = asyncio.get_running_loop()
        window = _Window(wanted, loop.time(), loop.create_future())
        self._windows.append(window)
        self._start()
        try:
            return await window.done
        finally:
            self._windows.remove(window)
            if not self._armed:
                await self._settle()

    async def close(self) -> None:
        """End reading; no task is left. The latch stays as it is."""
        self._armed = False
        await self._settle()
        for window in self._windows:
            if not window.done.done():
                window.done.set_exception(ImplausibleReading("the guard was closed", device=self._sensor.name))
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    @property
    def _wanted(self) -> bool:
        return self._armed or any(not window.done.done() for window in self._windows)

    def _start(self) -> None:
        if self._task is None or self._task.done():
            self._watch = replace(self._watch, next_sequence=None)
            self._idle = Watch(_NO_LIMITS, self._watch.frozen_samples)
            self._task = asyncio.get_running_loop().create_task(self._read(), name="force guard")
            self._task.add_done_callback(self._go_on)

    def _go_on(self, ended: asyncio.Task[None]) -> None:
        """Read again where somebody asked just when reading was being ended."""
        if ended is self._task and self._trip is None and self._wanted:
            self._start()

    async def _settle(self) -> None:
        """Wait until a trip was acted upon; end reading that nobody needs."""
        task = self._task
        if task is None or task.done():
            return
        if not self._acting and not self._wanted:
            task.cancel()
        if self._acting or not self._wanted:
            await asyncio.wait({task})

    async def _read(self) -> None:
        try:
            trip = await self._until_trip()
        except TimeoutError:
            trip = Trip(f"{self._watch.limits.label}: the force sensor stays silent")
        except Exception as error:  # whatever it is, the guard is blind now
            trip = Trip(f"{self._watch.limits.label}: {error}")
        if trip is not None:
            self._acting = True
            try:
                await self._act(trip)
            finally:
                self._acting = False

    async def _until_trip(self) -> Trip | None:
        async with asyncio.timeout(None) as timeout:
            silence = Silence(timeout)
            try:
                return await self._watch_blocks(silence)
            finally:
                silence.end()

    async def _watch_blocks(self, silence: Silence) -> Trip | None:
        loop, sensor = asyncio.get_running_loop(), self._sensor
        while self._wanted:
            limits = self._watch.limits if self._armed else _NO_LIMITS
            count = limits.block if self._armed else min(self._idle_block, max(w.wanted for w in self._windows))
            stale_s = limits.stale_ms * 1e-3 if self._armed else self._idle_stale_s
            silence.over_by(loop.time() + count / sensor.rate_hz + stale_s)
            block = await sensor.block(count, low_n=limits.tare_n + limits.low_n, high_n=limits.tare_n + limits.trip_n)
            if trip := self._look(block, loop.time()):
                return trip
        return None

    def _look(self, block: ForceBlock, now: float) -> Trip | None:
        self._time_s = now
        if self._from_before(block):
            self._watch = replace(self._watch, next_sequence=block.sequence + len(block.samples_n))
            return None
        if self._armed:
            self._watch, trip = check(self._watch, block, now)
        else:
            idle = replace(self._idle, next_sequence=self._watch.next_sequence)
            self._idle, trip = check(idle, block, now)
            self._watch = replace(self._watch, next_sequence=self._idle.next_sequence)
        if trip is None:
            for window in self._windows:
                window.take(block)
            if self._armed and self._proven is not None and not self._proven.done():
                self._proven.set_result(None)
        return trip

    def _from_before(self, block: ForceBlock) -> bool:
        """Whether `block` was taken wholly before the guard was armed: what a link had kept is let go, to a bound."""
        if self._proven is None or self._proven.done() or self._skipped >= MOST_SKIPPED:
            return False
        old = block.time_s + (len(block.samples_n) - 1) * block.period_s < self._armed_s
        self._skipped += old
        return old

    async def _act(self, trip: Trip) -> None:
        self._trip = trip
        self._latch.close("guard", trip.reason)
        self._trip = trip = await halt_all(self._axes, self._latch, trip, self._halt_deadline_s)
        if self._proven is not None and not self._proven.done():
            self._proven.set_result(None)
        for window in self._windows:
            if not window.done.done():
                window.done.set_exception(GuardTripped(trip.reason, force_n=trip.force_n))
