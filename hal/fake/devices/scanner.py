"""The fake structured-light camera: takes a picture of the plant as it stands, `hal.interfaces.Scanner`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import numpy as np
from numpy.typing import NDArray

from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted
from hal.fake.faults import FaultBook
from hal.fake.plant import Plant
from hal.fake.scene.picture import picture_of
from hal.fake.scene.render import SceneState
from hal.interfaces import Frame, Identity, SafeState, View

Cloud = NDArray[np.float32]
Render = Callable[[SceneState, int], Awaitable[Cloud]]
"""Where the picture is computed: `hal.fake.scene.render.render` inline or in a worker process."""

EXPOSURE_S = 0.8
"""Projecting and taking the fringe pictures."""
READOUT_S = 0.4
FRAME_DEADLINE_S = 5.0
STILL_MM = 0.02
"""Fringes are smeared when the scene moves further than this during the exposure."""
RIM = np.array([[150.0, 0.0, 0.0, 1.0], [0.0, 150.0, 0.0, 1.0]]).T
"""Places on a part (homogeneous, part frame) whose motion is looked at."""


class FakeScanner:
    """Frame ids grow with each capture since connect; the same plant seed and capture give the same cloud."""

    def __init__(self, plant: Plant, faults: FaultBook, render: Render, *, points: int, name: str = "scanner") -> None:
        self._plant = plant
        self._faults = faults
        self._render = render
        self._points = points
        self._name = name
        self._captures = 0
        self._last: Frame | None = None
        self._stopped: asyncio.Event | None = None
        self._lit = False

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def connect(self) -> Identity:
        """Who it is. Raises NotConnected or DeviceTimeout."""
        await self._faults.gate(self._name, "connect")
        return Identity("cellctl", "twin structured light", f"SL-{self._plant.settings.seed}", "1", simulated=True)

    async def close(self) -> None:
        """End a capture in flight."""
        self._stop()

    async def halt(self) -> None:
        """End a capture in flight, which raises Interrupted there."""
        await self._faults.gate(self._name, "halt")
        self._stop()

    async def safe(self) -> SafeState:
        """Safe while the projector is dark."""
        await self._faults.gate(self._name, "safe")
        return SafeState(not self._lit, "projecting" if self._lit else "projector dark")

    async def rearm(self) -> None:
        """Nothing is resumed: a capture is asked for anew."""
        await self._faults.gate(self._name, "rearm")

    async def capture(self, view: View) -> Frame:
        """One organised cloud. `half_frame`, `all_invalid`, `wrong_unit` and `old_frame` come as they would: as data.

        Raises DeviceRefused (arm not in the view, another capture in flight), DeviceFault (something moved during the
        exposure), DeviceTimeout (no frame), Interrupted (halted), NotConnected.
        """
        await self._faults.gate(self._name, "capture", deadline_s=FRAME_DEADLINE_S)
        if self._stopped is not None:
            raise DeviceRefused("a capture is in flight", device=self._name)
        self._stopped = stopped = asyncio.Event()
        try:
            frame = await self._take(view, stopped)
        finally:
            self._stopped, self._lit = None, False
        if stopped.is_set():
            raise Interrupted("halted during the capture", device=self._name)
        return frame

    async def _take(self, view: View, stopped: asyncio.Event) -> Frame:
        scene = await self._expose(view, stopped)
        now = asyncio.get_running_loop().time()
        if self._faults.active(self._name, "no_frame", now):
            await asyncio.sleep(FRAME_DEADLINE_S - EXPOSURE_S)
            raise DeviceTimeout(f"no frame within {FRAME_DEADLINE_S:g} s", device=self._name)
        if self._last is not None and self._faults.active(self._name, "old_frame", now):
            return self._last
        self._captures += 1
        frame_id = self._captures
        cloud = await self._render(scene, self._seed(view, frame_id))
        await asyncio.sleep(READOUT_S)
        frame = Frame(frame_id, view, now, self._spoiled(cloud, now))
        self._last = frame
        return frame

    async def _expose(self, view: View, stopped: asyncio.Event) -> SceneState:
        """The scene, which must stand still while the fringes are projected."""
        wanted = "rotor" if view in ("rotor", "artefact_rotor") else "shaft"
        before = self._look(view, wanted)
        self._lit = True
        try:
            async with asyncio.timeout(EXPOSURE_S):
                await stopped.wait()
        except TimeoutError:
            self._lit = False
        else:
            raise Interrupted("halted during the exposure", device=self._name)
        after = self._look(view, wanted)
        for (T_before, _), (T_after, _) in zip(before.parts, after.parts, strict=True):
            if np.abs((T_after - T_before) @ RIM).max() > STILL_MM:
                raise DeviceFault("something moved during the exposure", device=self._name)
        return after

    def _look(self, view: View, wanted: str) -> SceneState:
        self._plant.advance(asyncio.get_running_loop().time())
        if self._plant.camera != wanted:
            raise DeviceRefused(f"the arm is {self._plant.camera}, not in view {wanted}", device=self._name)
        return picture_of(self._plant, view, self._points)

    def _seed(self, view: View, frame_id: int) -> int:
        return int(self._plant.rng(self._name, view, str(frame_id)).integers(2**63))

    def _spoiled(self, cloud: Cloud, now: float) -> Cloud:
        if self._faults.active(self._name, "half_frame", now):
            cloud = cloud.copy()
            cloud[cloud.shape[0] // 2 :] = np.nan
        if self._faults.active(self._name, "all_invalid", now):
            cloud = np.full_like(cloud, np.nan)
        if self._faults.active(self._name, "wrong_unit", now):
            cloud = cloud * np.float32(1e-3)
        return cloud

    def _stop(self) -> None:
        if self._stopped is not None:
            self._stopped.set()
