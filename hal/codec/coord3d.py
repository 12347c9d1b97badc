"""3D data of GenICam cameras to an organised cloud: GenICam SFNC 2.7 chapter 20 (Scan3dControl), PFNC 2.4 names.

A frame is either one part in Coord3D_ABC32f (a point after the other) or Coord3D_ABC32f_Planar (three planes), or one
part for each of Coord3D_A32f, B32f and C32f. What the device transmits is scaled: coordinate = offset + scale * value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.codec.errors import CodecError

MILLIMETRE, GRID, CARTESIAN = "Millimeter", "CalibratedABC_Grid", "Cartesian"
"""The distance unit, output mode and coordinate system that a cloud is read in."""
LARGEST_SIDE = 65_536
_WHOLE, _PLANAR = "Coord3D_ABC32f", "Coord3D_ABC32f_Planar"
_PLANES = ("Coord3D_A32f", "Coord3D_B32f", "Coord3D_C32f")


class Coord3dError(CodecError):
    """Parts that make no organised cloud."""


class WrongSpace(Coord3dError):
    """Coordinates that are no Cartesian millimetres of a grid."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """How one of A, B and C is transmitted; `invalid` stands where nothing was measured, None where nothing does."""

    scale: float = 1.0
    offset: float = 0.0
    invalid: float | None = None


@dataclass(frozen=True, slots=True)
class Space:
    """What the nodes say: Scan3dDistanceUnit, Scan3dOutputMode, Scan3dCoordinateSystem, and each of A, B and C."""

    unit: str
    output_mode: str = GRID
    system: str = CARTESIAN
    coordinates: tuple[Coordinate, Coordinate, Coordinate] = (Coordinate(), Coordinate(), Coordinate())

    def check(self) -> None:
        """Raises WrongSpace."""
        for place, said, wanted in (
            ("Scan3dDistanceUnit", self.unit, MILLIMETRE),
            ("Scan3dOutputMode", self.output_mode, GRID),
            ("Scan3dCoordinateSystem", self.system, CARTESIAN),
        ):
            if said != wanted:
                raise WrongSpace(place, f"the frame is in {said!r}, not in {wanted!r}")


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a buffer: its PFNC pixel format, and its values in rows of `width`."""

    pixel_format: str
    width: int
    height: int
    values: NDArray[np.float32]


def cloud(parts: Sequence[Part], space: Space) -> NDArray[np.float32]:
    """(H, W, 3) float32 in mm, NaN where nothing was measured. Parts of other formats, such as pictures, are ignored.

    Raises WrongSpace, Coord3dError.
    """
    space.check()
    planes = _planes([part for part in parts if part.pixel_format in (_WHOLE, _PLANAR, *_PLANES)])
    points = np.empty((*planes[0].shape, 3), dtype=np.float32)
    measured = np.ones(planes[0].shape, dtype=bool)
    for axis, (values, coordinate) in enumerate(zip(planes, space.coordinates, strict=True)):
        if coordinate.invalid is not None:
            measured &= values != np.float32(coordinate.invalid)
        points[..., axis] = values.astype(np.float64) * coordinate.scale + coordinate.offset
    points[~(measured & np.isfinite(points).all(axis=2))] = np.nan
    return points


def _planes(parts: Sequence[Part]) -> list[NDArray[np.float32]]:
    """A, B and C, each (H, W)."""
    formats = [part.pixel_format for part in parts]
    if formats == [_WHOLE]:
        table = _checked(parts[0], 3).reshape(parts[0].height, parts[0].width, 3)
        return [table[..., axis] for axis in range(3)]
    if formats == [_PLANAR]:
        return list(_checked(parts[0], 3).reshape(3, parts[0].height, parts[0].width))
    if sorted(formats) != sorted(_PLANES):
        raise Coord3dError("parts", f"{formats or 'none'}: one of A, B, C together, or one of each, is needed")
    by_format = {part.pixel_format: part for part in parts}
    planes = [by_format[name] for name in _PLANES]
    if len({(part.width, part.height) for part in planes}) != 1:
        raise Coord3dError("parts", f"sizes {[(part.width, part.height) for part in planes]} differ")
    return [_checked(part, 1).reshape(part.height, part.width) for part in planes]


def _checked(part: Part, each: int) -> NDArray[np.float32]:
    """The values of a part, `each` a pixel."""
    if not (0 < part.width <= LARGEST_SIDE and 0 < part.height <= LARGEST_SIDE):
        raise Coord3dError(part.pixel_format, f"{part.width} x {part.height} pixels (limit {LARGEST_SIDE})")
    needed = part.width * part.height * each
    if part.values.size != needed:
        raise Coord3dError(part.pixel_format, f"half a frame: {part.values.size} of {needed} values")
    return part.values
