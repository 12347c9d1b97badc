"""The force guard as the controller sees it where it is a process of its own, `hal.interfaces.ForceGuard`.

The guard has stopped the drives before it tells of a trip; here the trip latches the cell, ends commands that were on
their way, and every axis acknowledges its halt. A guard that is lost is a trip, and so is one that starts anew: what it
was told to watch it does not watch.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Sequence

import numpy as np

from hal.errors import DeviceError, GuardTripped, ImplausibleReading
from hal.guard.halting import halt_all
from hal.guard.link import GuardLink, Told
from hal.guard.logic import Trip, Watch, check
from hal.guard.sentry import NO_LIMITS
from hal.interfaces import Axis, ForceBlock, ForceSensor, GuardLimits, GuardState
from hal.latch import Latch

START_S = 15.0
"""A guard that is started as a child is there by then, on a busy machine, too."""


class GuardClient:
    """`axes` are the bare axes; each has `halt_deadline_s` to acknowledge its halt.

    `frozen_samples` equal samples in a row are no living sensor's (0: any number).
    """

    def __init__(
        self,
        link: GuardLink,
        sensor: ForceSensor,
        axes: Sequence[Axis],
        latch: Latch,
        *,
        halt_deadline_s: float,
        frozen_samples: int = 0,
    ) -> None:
        self._link, self._sensor, self._axes, self._latch = link, sensor, axes, latch
        self._halt_deadline_s = halt_deadline_s
        self._frozen_samples = frozen_samples
        self._opened = False
        self._trip: Trip | None = None
        self._limits: GuardLimits | None = None
        self._state = GuardState(False, False, "", 0.0, 0.0, 0, 0.0)
        self._acting: asyncio.Task[None] | None = None
        self._windows: set[asyncio.Future[None]] = set()

    async def open(self) -> None:
        """Have the guard there before anything is asked of it. Raises NotConnected."""
        if not self._opened:
            self._link.on_told, self._link.on_lost = self._told, self._lost
            await self._link.reached(within_s=START_S)
            self._opened = True

    @property
    def alive(self) -> bool:
        """This side is alive as long as it is asked; whether the drives hear so is the guard's to decide."""
        return True

    def state(self) -> GuardState:
        """What the guard told last; tripped as long as this side has not been re-armed."""
        trip = self._trip
        armed = self._limits is not None
        return dataclasses.replace(
            self._state, armed=armed, tripped=trip is not None, reason=trip.reason if trip else ""
        )

    async def arm(self, limits: GuardLimits) -> None:
        """See `hal.guard.inloop.InLoopGuard.arm`. Raises also NotConnected, DeviceTimeout (the guard)."""
        if self._trip is not None:
            raise GuardTripped(f"latched: {self._trip.reason}", force_n=self._trip.force_n)
        if not (limits.low_n < limits.trip_n and np.isfinite(limits.tare_n) and limits.block >= 1):
            raise ImplausibleReading(f"limits that nothing can keep: {limits}", device=self._sensor.name)
        self._limits = limits
        self._link.beat()
        await self._link.call("arm", **dataclasses.asdict(limits))

    async def disarm(self) -> GuardState:
        """Stop watching; returns once a trip's halts have been acknowledged or given up."""
        self._limits = None
        try:
            await self._link.call("disarm")
        except DeviceError as error:
            self._close(Trip(f"the guard does not answer: {error.reason}"))
        await self._settle()
        return self.state()

    async def rearm(self) -> None:
        """Clear the latch; motion may be asked for again. Raises NotConnected, DeviceTimeout, GuardTripped."""
        await self._settle()
        link, told = self._link, self._link.told
        epoch = told.epoch if told else 0
        link.beat()
        await link.call("clear", epoch=epoch)
        if link.told is None or link.told.epoch != epoch:
            raise GuardTripped(f"tripped again: {link.told.reason if link.told else 'the guard is lost'}")
        link.epoch = epoch
        self._trip = None
        self._latch.open("guard")
        if self._limits is not None:
            await self.arm(self._limits)

    async def window(self, seconds: float) -> ForceBlock:
        """The samples of the next `seconds`. Raises GuardTripped: the guard trips meanwhile, or they are no force."""
        loop = asyncio.get_running_loop()
        tripped: asyncio.Future[None] = loop.create_future()
        reading = loop.create_task(self._window(seconds))
        self._windows.add(tripped)
        try:
            await asyncio.wait((tripped, reading), return_when=asyncio.FIRST_COMPLETED)
            if tripped.done():
                tripped.result()
            return reading.result()
        finally:
            self._windows.discard(tripped)
            tripped.cancel()
            reading.cancel()
            await asyncio.wait({reading})

    async def _window(self, seconds: float) -> ForceBlock:
        loop, sensor = asyncio.get_running_loop(), self._sensor
        wanted, since_s = max(1, round(seconds * sensor.rate_hz)), loop.time()
        watch, parts, first = Watch(NO_LIMITS, self._frozen_samples), [], None
        while wanted > 0:
            try:
                block = await sensor.block(wanted)
            except DeviceError as error:
                raise GuardTripped(f"idle: {error}") from None
            old = int(np.searchsorted(block.time_s + block.period_s * np.arange(len(block.samples_n)), since_s - 1e-6))
            watch, trip = check(watch, block, loop.time())
            if trip is not None:
                raise GuardTripped(trip.reason, force_n=trip.force_n)
            samples = block.samples_n[old:]
            if len(samples) and first is None:
                first = dataclasses.replace(
                    block, sequence=block.sequence + old, time_s=block.time_s + old * block.period_s
                )
            parts.append(samples)
            wanted -= len(samples)
        assert first is not None
        return dataclasses.replace(first, samples_n=np.concatenate(parts))

    async def close(self) -> None:
        """No task is left. The latch stays as it is."""
        self._link.on_told, self._link.on_lost = _nothing, _nothing
        await self._settle()
        if self._opened:
            self._opened = False
            await self._link.release()

    # ------------------------------------------------------------ trips

    def _told(self, told: Told) -> None:
        self._state = GuardState(
            told.armed, told.tripped, told.reason, told.peak_n, told.last_n, told.samples, told.time_s
        )
        if told.tripped:
            self._close(Trip(told.reason, told.force_n), act=self._link.epoch != 0)

    def _lost(self, reason: str) -> None:
        self._close(Trip(f"the guard is lost: {reason}"))

    def _close(self, trip: Trip, *, act: bool = True) -> None:
        """Latch the cell and act, once for each trip. Before it was ever re-armed there is nothing to halt."""
        if self._trip is not None:
            return
        self._trip = trip
        self._latch.close("guard", trip.reason)
        for window in self._windows:
            if not window.done():
                window.set_exception(GuardTripped(trip.reason, force_n=trip.force_n))
        if act:
            self._acting = asyncio.get_running_loop().create_task(self._act(trip), name="guard trip")

    async def _act(self, trip: Trip) -> None:
        self._trip = await halt_all(self._axes, self._latch, trip, self._halt_deadline_s)

    async def _settle(self) -> None:
        if self._acting is not None:
            await asyncio.wait({self._acting})


def _nothing(_: object) -> None:
    """Whoever tells something to a closed guard tells it nobody."""
