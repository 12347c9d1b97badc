"""Simulator of a 3D camera as a GenTL producer would show it, the fake scanner on the plant behind it."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from hal.bus.camera_socket import Answer, CameraServer
from hal.codec.coord3d import MILLIMETRE
from hal.errors import DeviceFault, DeviceRefused, DeviceTimeout, Interrupted, NotConnected
from hal.fake.devices.scanner import FakeScanner
from hal.fake.faults import FaultBook
from hal.interfaces import Frame, View

INVALID = -9999.0
"""Stands in plane C where nothing was measured."""
Layout = Literal["whole", "planar", "parts"]
_FORMATS = {
    "whole": ("Coord3D_ABC32f",),
    "planar": ("Coord3D_ABC32f_Planar",),
    "parts": ("Coord3D_A32f", "Coord3D_B32f", "Coord3D_C32f"),
}


@dataclass
class WireFaults:
    """What goes wrong on the way; counts are of frames."""

    half: int = 0
    """Frames of which only the first half comes."""
    hang_up: int = 0
    """Frames instead of which the camera hangs up."""
    silent: int = 0
    """Requests that are never answered."""
    unit: str = MILLIMETRE
    """What the nodes say."""
    layout: Layout = "parts"


class SimulatedCamera:
    """User sets are the views. `scanner` must not act out faults of the link itself (see `behind.BehindWire`)."""

    def __init__(self, scanner: FakeScanner, faults: FaultBook) -> None:
        self.name = scanner.name
        self.serial = f"{scanner.name}-1"
        self.wire = WireFaults()
        self.shots = 0
        """How often a frame was begun."""
        self.server = CameraServer(self._serve)
        self._scanner = scanner
        self._faults = faults
        self._shot: asyncio.Task[Frame] | None = None

    async def start(self, host: str = "127.0.0.1", port: int = 0) -> str:
        """Serve on a port of this machine, 0 for a free one; the address is returned."""
        await self.server.start(host, port)
        return f"socket://{host}:{self.server.port}"

    async def close(self) -> None:
        """Serve no more."""
        await self.server.close()
        await self._drop()
        await self._scanner.close()

    async def _serve(self, request: dict[str, Any]) -> Answer:
        if self.wire.silent:
            self.wire.silent -= 1
            await asyncio.sleep(math.inf)
        try:
            await self._faults.gate(self.name, str(request.get("do")), deadline_s=math.inf)
        except NotConnected:
            raise ConnectionAbortedError from None
        try:
            said, data = await self._obey(request)
        except DeviceRefused as error:
            said, data = {"ok": False, "error": "refused", "reason": error.reason}, b""
        except (DeviceFault, Interrupted) as error:
            said, data = {"ok": False, "error": "fault", "reason": error.reason}, b""
        return {"ok": True} | said, data

    async def _obey(self, request: dict[str, Any]) -> Answer:
        match request.get("do"):
            case "who":
                model = "twin structured light (GenTL)"
                return {"vendor": "cellctl", "model": model, "serial": self.serial, "firmware": "1"}, b""
            case "shoot":
                await self._drop()
                self.shots += 1
                capture = self._scanner.capture(cast(View, request.get("user_set", "")))
                self._shot = asyncio.create_task(capture, name=f"{self.name} shot")
            case "fetch":
                return await self._fetch(float(request.get("timeout_s", 0.0)))
            case "stop":
                await self._scanner.halt()
                await self._drop()
            case "lit":
                pass
            case unknown:
                raise DeviceRefused(f"unknown request {str(unknown)[:40]!r}", device=self.name)
        return {"lit": not (await self._scanner.safe()).safe}, b""

    async def _drop(self) -> None:
        """What is under way is nobody's any more."""
        shot, self._shot = self._shot, None
        if shot is not None:
            shot.cancel()
            await asyncio.wait({shot})
            if not shot.cancelled():
                shot.exception()

    async def _fetch(self, timeout_s: float) -> Answer:
        nothing: Answer = {"number": None}, b""
        if self._shot is None:
            await asyncio.sleep(timeout_s)
            return nothing
        await asyncio.wait({self._shot}, timeout=timeout_s)
        if not self._shot.done():
            return nothing
        shot, self._shot = self._shot, None
        try:
            return self._sent(shot.result())
        except DeviceTimeout:
            return nothing

    def _sent(self, frame: Frame) -> Answer:
        """The buffer of a frame and what the nodes say of it."""
        if self.wire.hang_up:
            self.wire.hang_up -= 1
            raise ConnectionAbortedError
        rows, columns = frame.points_mm.shape[:2]
        points = np.where(np.isfinite(frame.points_mm).all(axis=2, keepdims=True), frame.points_mm, 0.0)
        points[..., 2][~np.isfinite(frame.points_mm).all(axis=2)] = INVALID
        if self.wire.layout != "whole":
            points = np.moveaxis(points, 2, 0)
        data = np.ascontiguousarray(points, dtype="<f4").tobytes()
        if self.wire.half:
            self.wire.half -= 1
            data = data[: len(data) // 2]
        said = {
            "number": frame.frame_id,
            "age_s": asyncio.get_running_loop().time() - frame.time_s,
            "unit": self.wire.unit,
            "invalid": INVALID,
            "parts": [(name, columns, rows) for name in _FORMATS[self.wire.layout]],
        }
        return said, data
