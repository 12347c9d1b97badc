"""Fake remote I/O: what its devices share, the gap probes and the mirror of the safety circuit.

A coupler polls its inputs in the background, so a read answers at once with the present image; an output acts on
metal and takes the metal's time.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass

import numpy as np

from hal.errors import ConfigError, Interrupted, NotConnected, SafetyOpen
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.interfaces import Identity, Quality, Reading, SafeState, SafetyState


class IoDevice:
    """What the devices behind a coupler share: a name, the plant, a link that is up or down."""

    model = "remote I/O"

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        self.name = name
        self._plant = plant
        self._faults = faults
        self._connected = False

    async def connect(self) -> Identity:
        """Prove the device's identity."""
        await self._faults.gate(self.name, "connect")
        self._connected = True
        return Identity("cellctl", self.model, f"{self.name}-1", "1.0", simulated=True)

    async def close(self) -> None:
        """Drop the link."""
        self._connected = False

    async def halt(self) -> None:
        """Nothing moves here; the exchange proves that the device answers."""
        await self._exchange("halt")

    async def safe(self) -> SafeState:
        """Safe once it answers."""
        await self._exchange("safe")
        return SafeState(True, "moves nothing")

    async def rearm(self) -> None:
        """No set-point to be changed."""
        await self._exchange("rearm")

    async def _answer(self, command: str) -> float:
        """One request and its answer: the loop time. The plant stays as it is: for what does not depend on it."""
        if not self._connected:
            raise NotConnected(f"not connected ({command})", device=self.name)
        await self._faults.gate(self.name, command)
        return asyncio.get_running_loop().time()

    async def _exchange(self, command: str) -> float:
        """As `_answer`, with the plant advanced to the time returned."""
        now = await self._answer(command)
        self._plant.advance(now)
        return now

    async def _powered(self, command: str) -> float:
        """As `_exchange`, for an output that acts. Raises SafetyOpen while the hard-wired circuit is open."""
        now = await self._exchange(command)
        if cut := self._faults.power_cut(now):
            raise SafetyOpen(f"no power ({cut})", device=self.name)
        return now


class Stroke:
    """A motion of something with end switches: it takes its time and can be halted on the way."""

    def __init__(self) -> None:
        self._halted: asyncio.Event | None = None

    @property
    def under_way(self) -> bool:
        """Whether it moves."""
        return self._halted is not None

    def halt(self) -> None:
        """End it where it is."""
        if self._halted is not None:
            self._halted.set()

    async def run(self, seconds: float, *, device: str) -> None:
        """Wait out the stroke. Raises Interrupted when it is halted on the way; a second stroke ends the first."""
        self.halt()
        mine = self._halted = asyncio.Event()
        try:
            async with asyncio.timeout(seconds):
                await mine.wait()
        except TimeoutError:
            return
        finally:
            if self._halted is mine:
                self._halted = None
        raise Interrupted("halted on the way", device=device)


PROBE_PLACES = {"gap_probe_1": 0.0, "gap_probe_2": 120.0, "gap_probe_3": 240.0}
"""Angles of the probes about the cell's z, degrees."""


@dataclass(frozen=True, slots=True)
class ProbeData:
    """Capacitive gap probes outside the bolts. Beyond the range they say so."""

    radius_mm: float = 135.0
    range_mm: float = 2.0
    noise_mm: float = 0.001


class FakeGapProbe(IoDevice):
    """Implements `hal.interfaces.GapProbe`: true distance of the faces at its place, plus noise. With a mandrel in the
    chuck it is on the bracket beside it (`hal.fake.fixtures`)."""

    model = "gap probe"

    def __init__(self, name: str, plant: Plant, faults: FaultBook, data: ProbeData | None = None) -> None:
        """Raises ConfigError for a name that has no place at the joint."""
        super().__init__(name, plant, faults)
        if name not in PROBE_PLACES:
            raise ConfigError("has no place at the joint", place=f"devices.{name}")
        self._data = data or ProbeData()
        self._number = tuple(PROBE_PLACES).index(name)
        angle = math.radians(PROBE_PLACES[name])
        self._at_mm = (self._data.radius_mm * math.cos(angle), self._data.radius_mm * math.sin(angle))
        self._rng: np.random.Generator = plant.rng(name, "noise")

    async def read(self) -> Reading:
        """Gap in mm; BAD beyond the range."""
        now = await self._exchange("read")
        aside_mm = self._plant.probe_mm(self._number)
        true_mm = self._plant.gap_at(*self._at_mm) if aside_mm is None else aside_mm
        gap_mm = true_mm + self._data.noise_mm * float(self._rng.standard_normal())
        reading = self._faults.reading(self.name, gap_mm, now)
        if reading.value > self._data.range_mm:
            return Reading(self._data.range_mm, reading.time_s, Quality.BAD)
        return reading


class FakeSafety(IoDevice):
    """Implements `hal.interfaces.SafetyInputs`: the mirror of a circuit that works without it.

    A bench that has moved stays moved until the controller re-arms with the cause gone.
    """

    model = "safety mirror"

    def __init__(self, name: str, plant: Plant, faults: FaultBook) -> None:
        super().__init__(name, plant, faults)
        self._moved = False

    async def read(self) -> SafetyState:
        """The inputs as they are; two channels that disagree are unknown."""
        now = await self._answer("read")

        def on(kind: str) -> bool:
            return self._faults.active(self.name, kind, now) is not None

        self._moved = self._moved or on("bench_moved")
        return SafetyState(
            estop_released=None if on("channels_disagree") else not on("estop"),
            guards_closed=not on("guard_open"),
            sto_released=not self._faults.power_cut(now),
            bench_locked=not on("bench_unlocked"),
            bench_moved=self._moved,
            time_s=now,
        )

    async def rearm(self) -> None:
        """Clear the latch of a bench that stands again; the artefact check then proves where it stands."""
        now = await self._exchange("rearm")
        self._moved = self._faults.active(self.name, "bench_moved", now) is not None
