"""Fake load cell under the shaft, `hal.interfaces.ForceSensor`: the plant's jack force through a real sensor.

reading = gain (F + linearity + hysteresis + creep) + offset + noise, of the force one filter delay ago, in the range.
Samples are numbered on a grid of their own since connect; the noise of a sample depends on its number alone, so that
the same stream comes out however it is read. While the plant's motion stays as it is the samples to come are known:
they are computed ahead in one go, and a reader sleeps until its last one or the first that is out of its window.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.errors import NotConnected
from hal.fake.faults import FaultBook
from hal.fake.motion import CLOCK_S
from hal.fake.plant import Plant
from hal.interfaces import ForceBlock, Identity, SafeState
from hal.units import GRAVITY_M_S2

Array = NDArray[np.float64]

CHUNK = 1024
"""Samples computed at once."""
BUFFER_S = 0.1
"""What the link keeps for a reader that comes late; older samples are lost."""


@dataclass(frozen=True, slots=True)
class _Ahead:
    """Samples from number `first` on, valid for one state of the plant's motion."""

    first: int
    samples_n: Array
    state: tuple[object, ...]
    low_n: float
    """Least and largest of the samples; NaN where one is NaN."""
    high_n: float


class FakeForceSensor:
    """The jack's sensor. One reader."""

    def __init__(self, name: str, plant: Plant, faults: FaultBook, *, rate_hz: float, range_n: float) -> None:
        self._name = name
        self._plant = plant
        self._faults = faults
        self._rate_hz = rate_hz
        self._range_n = range_n
        self._start_s: float | None = None
        self._next = 0
        self._ahead: _Ahead | None = None
        self._waiter: asyncio.Future[bool] | None = None
        self._unsubscribe: Callable[[], None] | None = None
        self._seed = int(plant.rng(name, "noise").integers(2**63))

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self._rate_hz

    @property
    def range_n(self) -> float:
        """Beyond it the reading saturates."""
        return self._range_n

    async def connect(self) -> Identity:
        """Prove the amplifier's identity; the stream starts."""
        await self._faults.gate(self._name, "connect")
        if self._start_s is None:
            self._start_s = asyncio.get_running_loop().time()
            self._next, self._ahead = 0, None
            self._unsubscribe = self._plant.subscribe(self._wake)
        return Identity("cellctl", "load cell", f"{self._name}-1", "1.0", simulated=True)

    async def close(self) -> None:
        """Drop the link."""
        if self._unsubscribe is not None:
            self._unsubscribe()
        self._start_s = self._unsubscribe = None

    async def halt(self) -> None:
        """Nothing moves here; the exchange proves that the amplifier answers."""
        await self._exchange("halt")

    async def safe(self) -> SafeState:
        """Safe once it answers."""
        await self._exchange("safe")
        return SafeState(True, f"{self._name} only measures")

    async def rearm(self) -> None:
        """No set-point to be changed."""
        await self._exchange("rearm")

    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        """See `hal.interfaces.ForceSensor.block`."""
        start_s = await self._exchange("block")
        now = asyncio.get_running_loop().time()
        first = self._resume(now, start_s)
        if self._faults.take(self._name, "gap", now):
            first = self._next = first + max(1, int(BUFFER_S * self._rate_hz))
        parts: list[Array] = []
        have, done = 0, False
        while not done:
            samples = self._samples(first + have, count - have, start_s)
            stop = self._first_outside(samples, low_n, high_n)
            done = have + len(samples) >= count or stop < len(samples)
            wanted = samples[: stop + 1]
            if await self._until(start_s + (first + have + len(wanted) - 1) / self._rate_hz):
                # The motion has changed: what had been taken by now stays, the rest is computed anew.
                taken = math.floor((asyncio.get_running_loop().time() - start_s) * self._rate_hz + 1e-6)
                kept = max(taken + 1 - (first + have), 0)
                done = done and kept >= len(wanted)
                wanted = wanted[:kept]
            parts.append(wanted)
            have += len(wanted)
        self._next = first + have
        values = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return ForceBlock(first, start_s + first / self._rate_hz, 1.0 / self._rate_hz, values)

    async def _exchange(self, command: str) -> float:
        """Loop time of sample 0. Raises NotConnected and what the faults say."""
        if self._start_s is None:
            raise NotConnected(f"not connected ({command})", device=self._name)
        await self._faults.gate(self._name, command)
        return self._start_s

    def _resume(self, now: float, start_s: float) -> int:
        """Number of the next sample for a reader that asks at `now`."""
        newest = math.ceil((now - start_s) * self._rate_hz - 1e-6)
        if newest - self._next > BUFFER_S * self._rate_hz:
            self._next = newest
        return self._next

    async def _until(self, when_s: float) -> bool:
        """Sleep until `when_s`; true when the plant's motion or the sensor's faults changed before."""
        loop = asyncio.get_running_loop()
        while (now := loop.time()) < when_s - CLOCK_S:
            edge_s = self._faults.next_change(self._name, now)
            self._waiter = loop.create_future()
            timer = loop.call_at(min(when_s, edge_s), self._wake, False)
            try:
                if await self._waiter or edge_s <= when_s:  # a fault's edge: what comes after it is read anew
                    return True
            finally:
                timer.cancel()
                self._waiter = None
        if self._faults.active(self._name, "stale", loop.time()):
            # Nothing new comes: the reader's own deadline ends this.
            await asyncio.sleep(max(self._faults.next_change(self._name, loop.time()) - loop.time(), 0.0))
        return False

    def _wake(self, changed: bool = True) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(changed)

    # ------------------------------------------------------------ samples

    def _samples(self, first: int, count: int, start_s: float) -> Array:
        """The next samples from number `first` on: `count` of them or as many as are computed."""
        state = self._state()
        ahead = self._ahead
        if ahead is None or ahead.state != state or not ahead.first <= first < ahead.first + len(ahead.samples_n):
            self._plant.advance(asyncio.get_running_loop().time())
            length = min(CHUNK, max(count, 64)) if self._lateral_moves() else CHUNK
            samples = self._read(first, length, start_s)
            ahead = _Ahead(first, samples, self._state(), float(samples.min()), float(samples.max()))
            self._ahead = ahead
        at = first - ahead.first
        samples = ahead.samples_n[at : at + count]
        if not self._faults.any_of(self._name):
            return samples
        time_s = start_s + (first + np.arange(len(samples))) / self._rate_hz
        return self._faults.samples(self._name, samples, time_s)

    def _state(self) -> tuple[object, ...]:
        plant = self._plant
        versions = tuple(plant.motion[name].version for name in ("stage_x", "stage_y", "jack", "shaft_table"))
        return (*versions, plant.slip_deg, plant.chuck_clamped, id(plant.shaft), id(plant.rotor))

    def _lateral_moves(self) -> bool:
        plant = self._plant
        return any(plant.motion[name].moving(plant.now) for name in ("stage_x", "stage_y", "shaft_table"))

    def _read(self, first: int, count: int, start_s: float) -> Array:
        """What the amplifier sends for samples `first` .. `first + count - 1` under the present motion."""
        plant = self._plant
        table, true = plant.numbers.imperfections, plant.numbers.properties
        numbers = np.arange(first, first + count)
        time_s = start_s + numbers / self._rate_hz
        at_s = time_s - true.force_delay_s
        force = plant.jack_force_n(at_s)
        weight = plant.shaft.mass_kg * GRAVITY_M_S2
        share = force / self._range_n
        linearity = table.force_linearity * self._range_n * 4.0 * share * (1.0 - share)
        hysteresis = table.force_hysteresis * (force - weight) * plant.motion["jack"].direction
        creep = table.force_creep * weight * -np.expm1(-np.maximum(at_s - plant.loaded_s, 0.0) / true.force_creep_s)
        reading = plant.cell.force_gain * (force + linearity + hysteresis + creep)
        reading = reading + true.force_offset_n + table.force_noise_n * self._noise(first, count)
        return np.asarray(np.clip(reading, -self._range_n, self._range_n))

    def _noise(self, first: int, count: int) -> Array:
        """(count,) standard normal noise; a sample's noise follows from its number."""
        chunks = range(first // CHUNK, (first + count - 1) // CHUNK + 1)
        noise = np.concatenate(
            [np.random.Generator(np.random.PCG64((self._seed, chunk))).standard_normal(CHUNK) for chunk in chunks]
        )
        at = first - chunks[0] * CHUNK
        return noise[at : at + count]

    def _first_outside(self, samples: Array, low_n: float, high_n: float) -> int:
        """Index of the first sample outside [low, high], NaN included; the length where none is."""
        ahead = self._ahead
        as_computed = ahead is not None and samples.base is ahead.samples_n
        if ahead is not None and as_computed and low_n <= ahead.low_n and ahead.high_n <= high_n:
            return len(samples)
        outside = ~((samples >= low_n) & (samples <= high_n))
        return int(np.argmax(outside)) if outside.any() else len(samples)
