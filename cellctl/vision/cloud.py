"""A point cloud in memory, and how one is read: PLY, PCD, XYZ, NPY, NPZ in millimetres.

A file is read strictly: what is truncated, not finite throughout, empty or of the wrong unit is an error that names
the reason, never a cloud.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Refused

MIN_POINTS = 100
# A joint of 2 m at most, seen from some metres: a cloud whose middle spans under 2 mm is in metres, above 10 m in um.
SMALLEST_SPAN_MM = 2.0
LARGEST_SPAN_MM = 10_000.0
SAMPLE = 10_000


class Unreadable(Exception):
    """The file is no cloud: `place` names the file, `reason` says in one sentence what is wrong."""

    def __init__(self, reason: str, *, place: str) -> None:
        super().__init__(f"{place}: {reason}")
        self.reason = reason
        self.place = place


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points in millimetres, float32: (H, W, 3) of a camera's grid with NaN where invalid, or (N, 3)."""

    points: NDArray[np.float32]

    @property
    def organised(self) -> bool:
        """Whether neighbours in the array are neighbours in the view."""
        return self.points.ndim == 3

    @property
    def valid(self) -> int:
        """How many points are finite."""
        return int(np.count_nonzero(np.isfinite(self.points).all(axis=-1)))


def as_cloud(points: NDArray[np.float32] | NDArray[np.float64]) -> Cloud:
    """Cloud from an array (H, W, 3) or (N, 3). Raises Refused: too_few_points, not_finite, wrong_unit.

    Infinite values are refused; NaN in every coordinate means "no point here" and is kept.
    """
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise Refused("too_few_points", f"an array of shape {points.shape} holds no points (N, 3) or (H, W, 3)")
    array = np.ascontiguousarray(points, dtype=np.float32)
    flat = array.reshape(-1, 3)
    missing = np.isnan(flat)
    empty = missing[:, 0]
    if np.isinf(flat).any() or any((missing[:, axis] != empty).any() for axis in (1, 2)):
        raise Refused("not_finite", "the cloud holds points with infinite or partly missing coordinates")
    valid = len(flat) - int(np.count_nonzero(empty))
    if valid < MIN_POINTS:
        raise Refused("too_few_points", f"the cloud holds {valid} valid points, at least {MIN_POINTS} are needed")
    some = flat if valid < SAMPLE else flat[:: max(1, len(flat) // (4 * SAMPLE))]
    low, high = np.percentile(some[some[:, 0] == some[:, 0]], [5.0, 95.0], axis=0)
    span = float(np.max(high - low))
    if span < SMALLEST_SPAN_MM:
        raise Refused("wrong_unit", f"the cloud spans {span:.3g} mm: the file is probably in metres")
    if span > LARGEST_SPAN_MM:
        raise Refused("wrong_unit", f"the cloud spans {span:.3g} mm: the file is probably in micrometres")
    return Cloud(array)


def load_cloud(path: Path) -> Cloud:
    """Cloud from a file. Raises Unreadable, or Refused (not_finite, too_few_points, wrong_unit).

    NaN marks an invalid pixel of an organised cloud (and of PCD, whose writers use it); elsewhere it is refused.
    """
    from cellctl.vision import formats

    readers = {".ply": formats.read_ply, ".pcd": formats.read_pcd, ".xyz": formats.read_xyz, ".txt": formats.read_xyz}
    kind = path.suffix.lower()
    try:
        if kind in (".npy", ".npz"):
            points = _numpy(path)
        elif kind in readers:
            points = readers[kind](path.read_bytes())
        else:
            raise Unreadable(f"unknown kind of file '{kind}', known: ply, pcd, xyz, npy, npz", place=path.name)
    except (OSError, ValueError, EOFError, KeyError, MemoryError, zlib.error, zipfile.BadZipFile) as error:
        raise Unreadable(str(error) or type(error).__name__, place=path.name) from None
    if points.ndim == 2:
        finite = np.isfinite(points).all(axis=1)
        if kind == ".pcd":
            points = points[~np.isnan(points).all(axis=1)]
        elif not finite.all():
            raise Refused("not_finite", f"{int((~finite).sum())} of {len(points)} points are not finite")
    return as_cloud(points)


def _numpy(path: Path) -> NDArray[np.float64]:
    """Array of an NPY file, or the only one (or the one named `points`) of an NPZ. Raises ValueError."""
    with path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            array = loaded
        else:
            names = list(loaded.files)
            if "points" not in names and len(names) != 1:
                raise ValueError(f"holds the arrays {names}, expected one, or one named 'points'")
            array = loaded["points" if "points" in names else names[0]]
    if array.ndim not in (2, 3) or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
        raise ValueError(f"an array of shape {array.shape} and type {array.dtype} is no cloud (N, 3) or (H, W, 3)")
    return np.asarray(array, dtype=np.float64)
