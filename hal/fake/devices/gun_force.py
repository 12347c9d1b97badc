"""Fake contact force sensor of a gun: the socket's spring against whatever is before it."""

from __future__ import annotations

import asyncio
import math

import numpy as np
from numpy.typing import NDArray

from hal.errors import ConfigError, DeviceTimeout
from hal.fake.devices.guns import joints_of
from hal.fake.devices.io import IoDevice
from hal.fake.faults import EXCHANGE_DEADLINE_S, FaultBook
from hal.fake.joints.gun_memory import GunName
from hal.fake.plant import Plant
from hal.interfaces import ForceBlock

Array = NDArray[np.float64]
NOISE_N = 0.1


class FakeGunForce(IoDevice):
    """Implements `hal.interfaces.ForceSensor` for gun_force_a and gun_force_b."""

    model = "force sensor"

    def __init__(self, name: str, plant: Plant, faults: FaultBook, rate_hz: float, range_n: float) -> None:
        """Raises ConfigError for another name."""
        super().__init__(name, plant, faults)
        if name not in ("gun_force_a", "gun_force_b"):
            raise ConfigError("guns have gun_force_a and gun_force_b", place=f"devices.{name}")
        self._gun: GunName = "a" if name == "gun_force_a" else "b"
        self._rate_hz = rate_hz
        self._range_n = range_n
        self._sequence = 0
        self._next_s = -math.inf
        self._rng = plant.rng(name, "noise")

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self._rate_hz

    @property
    def range_n(self) -> float:
        """Full scale; the reading saturates there."""
        return self._range_n

    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        """The next `count` samples, fewer where one leaves [low_n, high_n]. Raises DeviceTimeout when none come."""
        now = await self._exchange("block")
        await self._until_fresh(now)
        period = 1.0 / self._rate_hz
        now = self._now()
        if self._next_s < now:
            self._next_s = now
        first_s, first = self._next_s, self._sequence
        noise = NOISE_N * self._rng.standard_normal(count)
        taken = 0
        samples: Array = np.empty(count)
        ended = False
        while taken < count and not ended:
            times: Array = first_s + period * np.arange(taken, count, dtype=np.float64)
            values = self._readings(times, noise[taken:])
            wrong = np.flatnonzero(~((values >= low_n) & (values <= high_n)))
            last = int(wrong[0]) if len(wrong) else len(values) - 1
            reached = await self._wait(float(times[last]))
            # What was foreseen holds up to the instant at which a motion changed.
            valid = last + 1 if reached else int(np.searchsorted(times, self._now(), side="right"))
            samples[taken : taken + valid] = values[:valid]
            taken += valid
            ended = reached and bool(len(wrong))
        self._sequence += taken
        self._next_s = first_s + taken * period
        if self._faults.active(self.name, "gap", self._now()):
            self._sequence += 1
            self._next_s += period
        return ForceBlock(first, first_s, period, samples[:taken].copy())

    def _readings(self, times_s: Array, noise_n: Array) -> Array:
        """(n,) what the sensor gives at `times_s` under the motion that is under way."""
        force = joints_of(self._plant).force_n(self._gun, times_s) + noise_n
        return self._faults.samples(self.name, np.clip(force, -self._range_n, self._range_n), times_s)

    async def _wait(self, until_s: float) -> bool:
        """Sleep to `until_s`; False when a motion changed before."""
        seconds = until_s - self._now()
        if seconds <= 0.0:
            return True
        changed = asyncio.Event()
        unsubscribe = self._plant.subscribe(changed.set)
        try:
            async with asyncio.timeout(seconds):
                await changed.wait()
        except TimeoutError:
            self._plant.advance(self._now())
            return True
        finally:
            unsubscribe()
        return False

    async def _until_fresh(self, now: float) -> None:
        """A frozen stream brings nothing new."""
        fault = self._faults.active(self.name, "stale", now)
        if fault is None:
            return
        left = self._faults.start_s(fault) + fault.duration_s - now
        await asyncio.sleep(min(left, EXCHANGE_DEADLINE_S))
        if left > EXCHANGE_DEADLINE_S:
            raise DeviceTimeout("no new samples", device=self.name)

    def _now(self) -> float:
        return asyncio.get_running_loop().time()
