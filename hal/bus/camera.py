"""A GenTL camera in this process: what `hal.bus.camera_process` has done in a worker of its own.

A producer is foreign code that may hang or crash, so everything here blocks, and nobody waits for it but that process.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
SOCKET = "socket://"
"""What the address of a camera on a TCP connection begins with; anything else is the path of a GenTL producer."""


class CameraError(Exception):
    """The camera cannot, for this reason."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class CameraRefused(CameraError):
    """What was asked is not done."""


class CameraLost(CameraError):
    """No camera, or no link to it."""


@dataclass(frozen=True, slots=True)
class Who:
    """Who a camera says it is."""

    vendor: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True, slots=True)
class Shot:
    """An organised cloud. `number` grows with each frame of an open camera; `age_s` since its exposure, where known."""

    number: int
    points_mm: NDArray[np.float32]
    age_s: float | None = None


class Camera(Protocol):
    """An open camera. Raises CameraError, or `hal.codec.coord3d.Coord3dError` for a frame that is none."""

    def who(self) -> Who: ...

    def lit(self) -> bool:
        """Whether it exposes, or is about to."""
        ...

    def shoot(self, user_set: str) -> None:
        """Begin one frame, with this set of the camera's settings where one is named; earlier frames are gone."""
        ...

    def fetch(self, timeout_s: float) -> Shot | None:
        """The frame, if it has come by then."""
        ...

    def stop(self) -> bool:
        """End what is under way; its frame never comes. Whether it is lit after that."""
        ...

    def close(self) -> None:
        """Let go of it. Never raises."""
        ...


_camera: Camera | None = None


def open_camera(address: str, serial: str, triggered: bool) -> Who:
    """Open the camera with this serial number, or the only one; one that is open, and not lost, is only asked again."""
    global _camera  # a process has one camera, and it stays open from call to call
    if _camera is None:
        if address.startswith(SOCKET):
            from hal.bus.camera_socket import SocketCamera

            _camera = SocketCamera(address)
        else:
            from hal.bus.gentl import HarvestedCamera

            _camera = HarvestedCamera(address, serial, triggered)
    return _do(lambda camera: camera.who())


def lit() -> bool:
    """See `Camera.lit`."""
    return _do(lambda camera: camera.lit())


def shoot(user_set: str) -> None:
    """See `Camera.shoot`."""
    _do(lambda camera: camera.shoot(user_set))


def fetch(timeout_s: float) -> Shot | None:
    """See `Camera.fetch`."""
    return _do(lambda camera: camera.fetch(timeout_s))


def stop() -> bool:
    """See `Camera.stop`."""
    return _do(lambda camera: camera.stop())


def _do(act: Callable[[Camera], T]) -> T:
    """One that is lost is let go, so that it can be opened anew."""
    global _camera
    if _camera is None:
        raise CameraLost("the camera is not open")
    try:
        return act(_camera)
    except CameraLost:
        lost, _camera = _camera, None
        lost.close()
        raise
