"""Scanner behind GenTL, `hal.interfaces.Scanner`: a camera in a process of its own gives organised 3D frames.

Frames are given as the camera made them: half empty, all invalid or too small ones are for the measurement to judge. A
frame whose number has not grown is an old frame and keeps the time of the newest one before it. A camera that does not
answer is ended with its process, and opened anew by the next command.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any, TypeVar

from hal.bus import camera
from hal.bus.camera_process import CameraProcess
from hal.codec.coord3d import Coord3dError, WrongSpace
from hal.entries import GentlEntry
from hal.errors import (
    DeviceError,
    DeviceFault,
    DeviceRefused,
    DeviceTimeout,
    ImplausibleReading,
    Interrupted,
    NotConnected,
    WorkerError,
)
from hal.interfaces import Frame, Identity, SafeState, View

T = TypeVar("T")
SIMULATOR = "cellctl"
"""What a simulator calls its vendor."""
LOOK_S = 0.05
"""How long the process waits for the frame before it listens again."""


class GentlScanner:
    """No task of its own: whoever captures asks for the frame until it has come."""

    def __init__(self, name: str, entry: GentlEntry) -> None:
        self._name = name
        self._entry = entry
        self._process = CameraProcess()
        self._connected = self._open = self._capturing = False
        self._halts = 0
        self._unwanted = False
        self._base = 0
        self._last: Frame | None = None

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def connect(self) -> Identity:
        """Open the camera and ask it who it is.

        Raises NotConnected (no producer, no camera), DeviceTimeout, DeviceRefused (not the one of the cell file).
        """
        told = await self._opened()
        if self._entry.serial and told.serial != self._entry.serial:
            raise DeviceRefused(f"camera {told.serial} answers, {self._entry.serial} is meant", device=self._name)
        self._connected = True
        return Identity(told.vendor, told.model, told.serial, told.firmware, simulated=told.vendor == SIMULATOR)

    async def close(self) -> None:
        """End the camera's process; a capture in flight ends with NotConnected."""
        self._connected = self._open = False
        await self._process.close()

    async def halt(self) -> None:
        """End a capture in flight, which raises Interrupted there; returns once the camera is dark."""
        self._halts += 1
        if await self._ask("halt", camera.stop):
            raise DeviceFault("the projector is lit after a halt", device=self._name)

    async def safe(self) -> SafeState:
        """Safe while the camera exposes nothing."""
        lit = await self._ask("safe", camera.lit)
        return SafeState(not lit, "projecting" if lit else "projector dark")

    async def rearm(self) -> None:
        """Nothing is resumed: a capture is asked for anew."""
        await self._ask("rearm", camera.lit)

    async def capture(self, view: View) -> Frame:
        """One organised cloud.

        Raises DeviceRefused (the camera refuses, another capture in flight), DeviceFault (the camera says so, half a
        frame), DeviceTimeout (no frame), ImplausibleReading (not in mm), Interrupted (halted), NotConnected.
        """
        if self._capturing:
            raise DeviceRefused("a capture is in flight", device=self._name)
        self._capturing, halts = True, self._halts
        try:
            if self._unwanted:
                await self._ask("capture", camera.stop)
            self._unwanted = True
            await self._ask("capture", camera.shoot, self._entry.user_sets.get(view, ""))
            frame = self._frame(view, await self._shot(halts))
            self._unwanted = False
        except DeviceError:
            with contextlib.suppress(DeviceError):
                await self._end()
            raise
        finally:
            self._capturing = False
        return frame

    async def _shot(self, halts: int) -> camera.Shot:
        """The frame that was begun."""
        loop = asyncio.get_running_loop()
        until_s = loop.time() + self._entry.frame_s
        while (left_s := until_s - loop.time()) > 0.0:
            shot = await self._ask("capture", camera.fetch, min(LOOK_S, left_s))
            if self._halts != halts:
                raise Interrupted("halted during the capture", device=self._name)
            if shot is not None:
                return shot
        raise DeviceTimeout(f"no frame within {self._entry.frame_s:g} s", device=self._name)

    async def _end(self) -> None:
        """A frame that nobody waits for any more shall not be taken for the next one."""
        if self._open:
            await self._ask("capture", camera.stop)
            self._unwanted = False

    def _frame(self, view: View, shot: camera.Shot) -> Frame:
        number, time_s, last = self._base + shot.number, asyncio.get_running_loop().time(), self._last
        time_s -= shot.age_s or 0.0
        if last is not None and number <= last.frame_id:
            return Frame(number, view, min(time_s, last.time_s), shot.points_mm)
        self._last = Frame(number, view, time_s, shot.points_mm)
        return self._last

    # ------------------------------------------------------------ the camera's process

    async def _opened(self) -> camera.Who:
        """Open the camera where it is not, and ask it. Its numbers go on from those it had before."""
        entry = self._entry
        await self._process.start()
        told = await self._call(
            "connect", camera.open_camera, entry.producer, entry.serial, entry.trigger == "software"
        )
        if not self._open:
            self._open, self._base = True, self._last.frame_id if self._last is not None else 0
        return told

    async def _ask(self, command: str, function: Callable[..., T], *args: Any) -> T:
        """What the open camera says. Raises as `capture` does."""
        if not self._connected:
            raise NotConnected(f"not connected ({command})", device=self._name)
        if not self._open:
            await self._opened()
        return await self._call(command, function, *args)

    async def _call(self, command: str, function: Callable[..., T], *args: Any) -> T:
        name, deadline_s = self._name, self._entry.reply_s
        try:
            return await self._process.call(deadline_s, function, *args)
        except TimeoutError:
            self._open = False
            raise DeviceTimeout(f"no answer to {command} within {deadline_s:g} s", device=name) from None
        except (WorkerError, camera.CameraLost) as error:
            self._open = False
            raise NotConnected(f"{error} ({command})", device=name) from None
        except camera.CameraRefused as error:
            raise DeviceRefused(error.reason, device=name) from None
        except WrongSpace as error:
            raise ImplausibleReading(str(error), device=name) from None
        except (camera.CameraError, Coord3dError) as error:
            raise DeviceFault(str(error), device=name) from None
