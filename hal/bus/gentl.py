"""Cameras behind a GenTL producer (a .cti file), through harvesters: its only importer. See `hal.bus.camera`."""

from __future__ import annotations

import contextlib
import logging
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from hal.bus.camera import CameraError, CameraLost, CameraRefused, Shot, Who
from hal.codec import coord3d

try:
    from genicam.genapi import GenericException as NodeError
    from genicam.gentl import GenericException as ProducerError
    from harvesters.core import Callback, Harvester
except ImportError as error:
    raise CameraLost(f"cameras behind GenTL need the extra gentl: {error}") from None

for _name in ("harvesters", "harvesters.core"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)  # the errors raised here say it

_3D, _EXPOSING = "Coord3D_", "ExposureActive"
DRAIN_S = 0.002
"""How long a frame is looked for that shall not be there."""


class HarvestedCamera:
    """Triggered by software, the acquisition stands between frames, so that their numbers go on; else it is started for
    each frame, which the camera then takes by itself."""

    def __init__(self, producer: str, serial: str, triggered: bool) -> None:
        if not Path(producer).is_file():
            raise CameraLost(f"no GenTL producer {producer}")
        self._triggered = triggered
        self._base = self._last = 0
        self._waiting = self._half = False
        self._harvester = Harvester()
        try:
            self._harvester.add_file(producer)
            self._harvester.update()
            self._acquirer = self._harvester.create(self._place(serial))
            self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, _Call(self._incomplete))
            self._nodes = self._acquirer.remote_device.node_map
            selector = getattr(self._nodes, "AcquisitionStatusSelector", None)
            self._tells = selector is not None and _EXPOSING in selector.symbolics
            self._set_up()
        except (ProducerError, NodeError) as error:
            self.close()
            raise CameraLost(_text(error)) from None
        except CameraError:
            self.close()
            raise

    def _place(self, serial: str) -> int:
        """Where the wanted camera stands in the producer's list."""
        serials = [info.serial_number for info in self._harvester.device_info_list]
        if not serials or (serial and serial not in serials):
            raise CameraLost(f"the producer shows cameras {serials or 'none'}, meant is {serial or 'any'}")
        if not serial and len(serials) > 1:
            raise CameraRefused(f"the producer shows cameras {serials}: the cell file must name one")
        return serials.index(serial) if serial else 0

    def _set_up(self) -> None:
        """The range component on, software trigger if asked for."""
        if self._has("ComponentSelector"):
            self._set("ComponentSelector", "Range")
            self._set("ComponentEnable", True)
        if self._triggered:
            if self._has("TriggerSelector"):
                self._set("TriggerSelector", "FrameStart")
            self._set("TriggerMode", "On")
            self._set("TriggerSource", "Software")

    def who(self) -> Who:
        """From the producer's own words."""
        device = self._acquirer.device
        return Who(device.vendor, device.model, device.serial_number, device.version)

    def lit(self) -> bool:
        """The camera's own word where it has one; else whether a frame was begun and neither came nor was stopped."""
        if not self._tells:
            return self._waiting
        self._set("AcquisitionStatusSelector", _EXPOSING)
        return bool(self._get("AcquisitionStatus"))

    def shoot(self, user_set: str) -> None:
        """See `hal.bus.camera.Camera.shoot`."""
        if user_set or not self._triggered:
            self.stop()
        if user_set:
            self._set("UserSetSelector", user_set)
            self._execute("UserSetLoad")
            self._set_up()
        try:
            if not self._acquirer.is_acquiring():
                self._base = self._last
                self._acquirer.start()
            while self._triggered and (old := self._acquirer.try_fetch(timeout=DRAIN_S)) is not None:
                old.queue()
        except (ProducerError, NodeError) as error:
            _raise(error)
        self._half, self._waiting = False, True
        if self._triggered:
            self._execute("TriggerSoftware")

    def fetch(self, timeout_s: float) -> Shot | None:
        """See `hal.bus.camera.Camera.fetch`."""
        try:
            buffer = self._acquirer.try_fetch(timeout=timeout_s)
            if self._half:
                self._half = self._waiting = False
                raise coord3d.Coord3dError("buffer", "half a frame: the producer calls it incomplete")
            if buffer is None:
                return None
            with buffer:
                self._waiting = False
                self._last = max(self._last, self._base + buffer.module.frame_id)
                number = self._base + buffer.module.frame_id
                parts = [_part(one) for one in buffer.payload.components if one and one.data_format.startswith(_3D)]
                points_mm = coord3d.cloud(parts, self._space())
        except (ProducerError, NodeError) as error:
            _raise(error)
        if not self._triggered:
            self.stop()
        return Shot(number, points_mm)

    def stop(self) -> bool:
        """See `hal.bus.camera.Camera.stop`."""
        try:
            if self._acquirer.is_acquiring():
                self._acquirer.stop()
        except (ProducerError, NodeError) as error:
            _raise(error)
        self._waiting = False
        return self.lit()

    def close(self) -> None:
        """Let go of camera and producer."""
        with contextlib.suppress(ProducerError, NodeError):
            self._harvester.reset()

    def _incomplete(self) -> None:
        self._half = True

    def _space(self) -> coord3d.Space:
        """What the nodes say; those that a camera does not have are as SFNC has them by default."""
        coordinates = []
        for letter in "ABC":
            if self._has("Scan3dCoordinateSelector"):
                self._set("Scan3dCoordinateSelector", f"Coordinate{letter}")
            flagged = self._get("Scan3dInvalidDataFlag", False)
            invalid = self._get("Scan3dInvalidDataValue", None) if flagged else None
            scale, offset = self._get("Scan3dCoordinateScale", 1.0), self._get("Scan3dCoordinateOffset", 0.0)
            coordinates.append(coord3d.Coordinate(scale, offset, invalid))
        a, b, c = coordinates
        return coord3d.Space(
            unit=self._get("Scan3dDistanceUnit", "no unit"),
            output_mode=self._get("Scan3dOutputMode", coord3d.GRID),
            system=self._get("Scan3dCoordinateSystem", coord3d.CARTESIAN),
            coordinates=(a, b, c),
        )

    # ------------------------------------------------------------ nodes

    def _has(self, name: str) -> bool:
        return hasattr(self._nodes, name)

    def _get(self, name: str, *default: Any) -> Any:
        try:
            return getattr(self._nodes, name).value
        except (NodeError, AttributeError) as error:
            if default:
                return default[0]
            raise CameraError(f"node {name}: {_text(error)}") from None

    def _set(self, name: str, value: Any) -> None:
        try:
            node = getattr(self._nodes, name)
            if node.value != value:
                node.value = value
        except (NodeError, AttributeError) as error:
            raise CameraRefused(f"node {name} does not take {value!r}: {_text(error)}") from None

    def _execute(self, name: str) -> None:
        try:
            getattr(self._nodes, name).execute()
        except (NodeError, AttributeError) as error:
            raise CameraRefused(f"{name}: {_text(error)}") from None


class _Call(Callback):  # type: ignore[misc]  # of a package without types
    """A callback as harvesters wants it."""

    def __init__(self, function: Any) -> None:
        self._function = function

    def emit(self, context: Any) -> None:
        self._function()


def _part(component: Any) -> coord3d.Part:
    # The buffer goes back to the producer, so the values are copied.
    values = np.array(component.data, dtype=np.float32)
    return coord3d.Part(component.data_format, component.width, component.height, values)


def _text(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _raise(error: BaseException) -> NoReturn:
    """An acquisition that fails may be a camera that is gone: it is opened anew. The producer's errors do not travel to
    another process, so their text does."""
    raise CameraLost(f"the acquisition failed: {_text(error)}") from None
