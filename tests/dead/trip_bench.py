"""One jack on the twin's plant under the guard's sentry, run by the step itself: what force is there once it stands.

The step arms the limits, so the trip is the one of production. A sample comes to the sentry late by the adapter, the
quick stop to the drive late by a drawn reaction of guard and bus; filter, drive and brake are the twin's.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cellctl.assembly import guard_plan
from cellctl.calibration import Calibration
from cellctl.ports import RunContext, RunHeld
from cellctl.recipe import Recipe
from cellctl.steps.jack_up import jack_up
from cellctl.steps.results import Aligned
from hal.config import CellConfig
from hal.errors import GuardTripped
from hal.fake.devices.build import fake_devices
from hal.fake.devices.force import FakeForceSensor
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.guard.sentry import Sentry
from hal.interfaces import ForceBlock, GuardLimits, GuardState

Array = NDArray[np.float64]

DEVICES = ("jack", "gun_feed", "camera_park", "chuck", "safety", "jack_force")
FIRST, REST = 10, 90
"""Samples read in one go, the first ones after arming and those after: a read ends at one beyond the limits."""
SWING_S = 0.5
"""After standstill: longer than the mass swings on a contact."""


@dataclass(frozen=True, slots=True)
class Stage:
    """The delays that are drawn for each trip, seconds: adapter of the sensor's line, guard and bus together."""

    adapter_s: float
    reaction_s: float


@dataclass(frozen=True, slots=True)
class Stopped:
    """One trip: net force that tripped and true contact force, newton, largest from standstill on."""

    trip_n: float
    rest_n: float
    stiffness_n_per_mm: float
    z_mm: float
    stage: Stage


def _nowhere(samples: Array) -> None:
    """Nobody gathers them."""


@dataclass
class Guarded:
    """`cellctl.ports.Interlock` by a sentry that reads the twin's sensor. `stopped` has every trip by force."""

    plant: Plant
    devices: Any
    draw: Callable[[], Stage]
    frozen_samples: int
    stopped: list[Stopped] = field(default_factory=list)

    def __post_init__(self) -> None:
        forever = dict.fromkeys(("beat_s", "quiet_s", "consumer_s"), math.inf)
        self._loop = asyncio.get_running_loop()
        self._sentry = Sentry(self._stop, lambda: None, frozen_samples=self.frozen_samples, **forever)
        self._sensor: FakeForceSensor = self.devices.jack_force
        self._limits: GuardLimits | None = None
        self._halt: asyncio.Task[None] | None = None
        self._watch: asyncio.Task[None] | None = None
        self._gather: Callable[[Array], None] = _nowhere
        self._stage = self.draw()
        self._clear()

    def _clear(self) -> None:
        now = self._loop.time()
        self._sentry.beat(now)
        self._sentry.heartbeat_sent(now)
        assert self._sentry.clear(self._sentry.gate.epoch, now) == ""

    # ------------------------------------------------------------ the interlock

    async def arm(self, limits: GuardLimits) -> None:
        """Returns once a first sample was looked at."""
        self._limits, self._stage = limits, self.draw()
        self._sentry.arm(limits, self._loop.time())
        while not (self._sentry.proven or self._sentry.trip):
            await self._read(FIRST)
        self._watch = asyncio.create_task(self._watching())

    async def disarm(self) -> GuardState:
        """After a trip once the jack stands."""
        if self._watch is not None:
            self._watch.cancel()
            await asyncio.wait({self._watch})
        self._sentry.disarm()
        if self._halt is not None:
            await self._halt
            self._halt = None
            self._note()
        self._limits = None
        return self.state()

    async def rearm(self) -> None:
        """Clear a trip."""
        self._clear()

    def state(self) -> GuardState:
        """What the sentry knows."""
        return self._sentry.state(self._loop.time())

    async def window(self, seconds: float) -> ForceBlock:
        """Armed, the samples that are read anyway."""
        count = round(seconds * self._sensor.rate_hz)
        gathered: list[Array] = []
        if self._limits is None:
            return await self._sensor.block(count)
        self._gather = gathered.append
        while sum(map(len, gathered)) < count:
            await asyncio.sleep(REST / self._sensor.rate_hz)
            if self._sentry.trip is not None:
                raise GuardTripped(self._sentry.trip.reason, force_n=self._sentry.trip.force_n)
        self._gather = _nowhere
        return ForceBlock(0, 0.0, 1.0 / self._sensor.rate_hz, np.concatenate(gathered)[-count:])

    # ------------------------------------------------------------ samples in, quick stop out

    async def _watching(self) -> None:
        while self._sentry.trip is None:
            await self._read(REST)

    async def _read(self, count: int) -> None:
        limits = self._limits
        assert limits is not None
        low_n, high_n = limits.tare_n + limits.low_n, limits.tare_n + limits.trip_n
        block = await self._sensor.block(count, low_n=low_n, high_n=high_n)
        await asyncio.sleep(self._stage.adapter_s)
        self._sentry.samples(block, self._loop.time())
        self._gather(block.samples_n)

    def _stop(self) -> None:
        async def halt() -> None:
            await asyncio.sleep(self._stage.reaction_s)
            await self.devices.jack.halt()

        if self._limits is not None:
            self._halt = asyncio.create_task(halt())

    def _note(self) -> None:
        """The true force from standstill on, as the mass swings on the contact."""
        plant, now, trip = self.plant, self._loop.time(), self._sentry.trip
        if trip is None or math.isnan(trip.force_n) or self._limits is None or self._limits.label != "insert":
            return
        plant.advance(now)
        z_mm = plant.motion["jack"].position(now)
        curve, ring = plant.engagement.curve(plant.dock(), z_mm), plant.engagement.ring
        swing = ring.at(now + np.linspace(0.0, SWING_S, 1001)) if ring else np.zeros(1)
        rest_n = float(curve.force_n(z_mm + swing, inwards=True).max())
        self.stopped.append(Stopped(trip.force_n, rest_n, curve.stiffness_n_per_mm(z_mm), z_mm, self._stage))


class _Told:
    """Ledger, progress and checkpoint of a run that nobody keeps."""

    async def act(self, device: str, command: str, arguments: object, do: Callable[[str], Awaitable[Any]]) -> Any:
        return await do("")

    async def note(self, kind: str, value: object) -> None: ...

    async def blob(self, kind: str, arrays: object) -> str:
        return ""

    def report(self, phase: str, fraction: float, text: str) -> None: ...

    async def __call__(self, retreat: object = None, resume: object = None, *, ask: str = "") -> None: ...


async def inserted(
    plant: Plant, recipe: Recipe, config: CellConfig, belief: Calibration, approach_mm: float, draw: Callable[[], Stage]
) -> tuple[list[Stopped], str]:
    """Phase jack up from a stand-off at `approach_mm` on: every trip of its insertion, and why it was held, if it was.

    `belief` is what the controller takes for the force sensor's gain.
    """
    loop = asyncio.get_running_loop()
    made = fake_devices(config, plant, FaultBook(), cast(Any, None), DEVICES)
    for device in made.values():
        await device.connect()
    devices = SimpleNamespace(**made)
    guarded, told = Guarded(plant, devices, draw, config.guard.frozen_samples), _Told()
    run = RunContext(
        devices=cast(Any, devices),
        recipe=recipe,
        calibration=belief,
        guard_plan=guard_plan(recipe, config),
        ledger=told,
        progress=told,
        checkpoint=told,
        interlock=guarded,
        vision=cast(Any, None),
        rotor_serial="",
        shaft_serial="",
    )
    target = SimpleNamespace(z_mm=config.cell.rotor_face_mm)
    alignment = SimpleNamespace(approach_z_mm=approach_mm, target=target)
    aligned = cast(Aligned, SimpleNamespace(alignment=alignment, expires_at_s=loop.time() + 1e6))
    held = ""
    try:
        await jack_up(run, aligned)
    except RunHeld as error:
        held = error.code
    for device in made.values():
        await device.close()
    return guarded.stopped, held
