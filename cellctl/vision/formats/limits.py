"""What every reader shares: how much is plausible, and how columns become points."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Coordinates = NDArray[np.float32]
MAX_POINTS = 20_000_000
"""Four times the largest cloud that is meant to be measured."""
MAX_BYTES = 2_000_000_000


def count_of(text: str) -> int:
    """A number of points in a header. Raises ValueError where it is none or not plausible."""
    value = int(text)
    if not 0 <= value <= MAX_POINTS:
        raise ValueError(f"{value} points are not plausible, at most {MAX_POINTS} are read")
    return value


def numbers(body: bytes, columns: int, rows: int) -> NDArray[np.float64]:
    """The table (rows, columns) of a text. Raises ValueError where it has another shape."""
    if not body.strip():
        raise ValueError(f"{rows} lines announced, none found")
    table = np.loadtxt(io.BytesIO(body), dtype=np.float64, comments=None, ndmin=2)
    if table.shape != (rows, columns):
        raise ValueError(f"{rows} lines of {columns} numbers announced, {table.shape[0]} of {table.shape[1]} found")
    return table


def ends_with_a_line(body: bytes) -> None:
    """A text that stops inside a line may have lost digits of its last number, which nothing else would show."""
    if not body.endswith((b"\n", b"\r")):
        raise ValueError("truncated: the last line does not end")


def ends_here(rest: memoryview, record: int) -> None:
    """No further record follows the data: a header that announces too few points would hide some.

    Zeros may follow, because the Point Cloud Library fills whole pages.
    """
    if len(rest) >= max(record, 2) and np.frombuffer(rest, dtype=np.uint8).any():
        raise ValueError(f"{len(rest)} bytes follow the announced points")


def xyz_places(names: Sequence[str]) -> tuple[int, int, int]:
    """Where x, y and z stand among the columns. Raises ValueError where one is missing or named twice."""
    if any(names.count(axis) != 1 for axis in "xyz"):
        raise ValueError(f"x, y and z are not named once each among {list(names)[:12]}")
    return names.index("x"), names.index("y"), names.index("z")


def points_of(columns: Sequence[NDArray[Any]]) -> Coordinates:
    """(N, 3) out of the columns x, y, z of any number type; what float32 cannot hold becomes infinite."""
    points = np.empty((len(columns[0]), 3), dtype=np.float32)
    with np.errstate(over="ignore"):
        for axis, column in enumerate(columns):
            points[:, axis] = column
    return points
