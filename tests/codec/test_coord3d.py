"""3D buffers of GenICam cameras: the three ways they come in, their scale, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hal.codec.coord3d import Coord3dError, Coordinate, Part, Space, WrongSpace, cloud

MM = Space("Millimeter")
HEIGHT, WIDTH = 3, 5
LAYOUTS = ("whole", "planar", "parts")


def points(seed: int = 1) -> NDArray[np.float32]:
    return np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32)


def parts_of(values: NDArray[np.float32], layout: str) -> list[Part]:
    planes = np.moveaxis(values, 2, 0)
    match layout:
        case "whole":
            return [Part("Coord3D_ABC32f", WIDTH, HEIGHT, values.ravel())]
        case "planar":
            return [Part("Coord3D_ABC32f_Planar", WIDTH, HEIGHT, planes.ravel())]
    named = zip("CAB", (planes[2], planes[0], planes[1]), strict=True)
    return [Part(f"Coord3D_{letter}32f", WIDTH, HEIGHT, plane.ravel()) for letter, plane in named]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_cloud_and_pictures_beside_it_are_ignored(layout: str) -> None:
    picture = Part("RGBa8", WIDTH, HEIGHT, np.zeros(4 * WIDTH * HEIGHT, np.float32))
    back = cloud([picture, *parts_of(points(), layout)], MM)
    assert back.dtype == np.float32
    assert np.array_equal(back, points())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_values_are_scaled_and_shifted_by_coordinate(layout: str) -> None:
    scales = Coordinate(0.5, 10.0), Coordinate(2.0, -3.0), Coordinate(0.1, 300.0)
    back = cloud(parts_of(points(), layout), Space("Millimeter", coordinates=scales))
    assert back == pytest.approx(points() * (0.5, 2.0, 0.1) + (10.0, -3.0, 300.0), abs=1e-4)


def test_a_point_with_an_invalid_or_not_finite_coordinate_is_none() -> None:
    values = points()
    values[0, 0, 2], values[1, 1, 0], values[2, 2, 1], values[2, 3, 2] = -1.0, np.nan, np.inf, 0.0
    flagged = Space("Millimeter", coordinates=(Coordinate(), Coordinate(), Coordinate(invalid=-1.0)))
    back = cloud(parts_of(values, "parts"), flagged)
    none = np.isnan(back).all(axis=2)
    assert sorted(zip(*np.nonzero(none), strict=True)) == [(0, 0), (1, 1), (2, 2)]
    assert np.isfinite(back[~none]).all()
    assert np.isfinite(cloud(parts_of(values, "parts"), MM)[0, 0]).all(), "without the flag the value counts"


@pytest.mark.parametrize(
    ("space", "place"),
    [
        (Space("Meter"), "Scan3dDistanceUnit"),
        (Space("Inch"), "Scan3dDistanceUnit"),
        (Space("no unit"), "Scan3dDistanceUnit"),
        (Space("Millimeter", output_mode="RectifiedC"), "Scan3dOutputMode"),
        (Space("Millimeter", system="Spherical"), "Scan3dCoordinateSystem"),
    ],
)
def test_anything_but_cartesian_millimetres_of_a_grid_is_refused(space: Space, place: str) -> None:
    with pytest.raises(WrongSpace) as caught:
        cloud(parts_of(points(), "parts"), space)
    assert caught.value.place == place


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ([], "none"),
        (parts_of(points(), "parts")[:2], "one of each"),
        (parts_of(points(), "whole") * 2, "one of each"),
        (parts_of(points(), "whole") + parts_of(points(), "parts"), "one of each"),
        ([*parts_of(points(), "parts")[:2], Part("Coord3D_B32f", HEIGHT, WIDTH, points()[..., 1].ravel())], "differ"),
        ([Part("Coord3D_ABC32f", 0, HEIGHT, points().ravel())], "pixels"),
        ([Part("Coord3D_ABC32f", 2**20, HEIGHT, points().ravel())], "limit"),
    ],
)
def test_parts_that_make_no_cloud_are_refused(parts: list[Part], reason: str) -> None:
    with pytest.raises(Coord3dError, match=reason):
        cloud(parts, MM)


@given(layout=st.sampled_from(LAYOUTS), share=st.floats(0.0, 0.999), more=st.booleans())
def test_half_a_part_is_half_a_frame(layout: str, share: float, more: bool) -> None:
    *rest, last = parts_of(points(), layout)
    values = np.append(last.values, np.float32(0)) if more else last.values[: int(share * last.values.size)]
    with pytest.raises(Coord3dError, match="half a frame"):
        cloud([*rest, Part(last.pixel_format, WIDTH, HEIGHT, values)], MM)
