"""A point cloud in memory, and how one is read: PLY, PCD, XYZ, NPY, NPZ in millimetres.

A file is read strictly: what is truncated, not finite throughout, empty or of the wrong unit is an error that names
the reason, never a cloud.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellctl.vision import formats
from cellctl.vision.part import Refused

READERS: Mapping[str, Callable[[bytes], NDArray[np.float32]]] = {
    ".ply": formats.read_ply,
    ".pcd": formats.read_pcd,
    ".xyz": formats.read_xyz,
    ".txt": formats.read_xyz,
    ".npy": formats.read_npy,
    ".npz": formats.read_npz,
}
MIN_POINTS = 100
# A joint of 2 m at most, seen from some metres: a cloud whose middle spans under 2 mm is in metres, above 10 m in um.
SMALLEST_SPAN_MM = 2.0
LARGEST_SPAN_MM = 10_000.0
# Beyond this a step of float32 is 2 um or more.
FARTHEST_MM = 30_000.0
# No instrument errs by a kilometre: a number beyond is damaged.
STRAY_MM = 1e6
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
    """Cloud from an array (H, W, 3) or (N, 3). Raises Refused: too_few_points, not_finite, wrong_unit, out_of_range.

    Infinite values are refused; NaN in every coordinate means "no point here" and is kept. A grid of a single row or
    column has no neighbours across and counts as a list.
    """
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise Refused("too_few_points", f"an array of shape {points.shape} holds no points (N, 3) or (H, W, 3)")
    array = np.ascontiguousarray(points, dtype=np.float32)
    flat = array.reshape(-1, 3)
    missing = np.isnan(flat)
    # along the flat array "missing" may only change from one point to the next, never within one
    changes = missing.reshape(-1)[1:] != missing.reshape(-1)[:-1]
    split = np.count_nonzero(changes) != np.count_nonzero(changes[2::3])
    farthest = max(np.fmax.reduce(flat, axis=None, initial=0.0), -np.fmin.reduce(flat, axis=None, initial=0.0))
    if split or farthest > STRAY_MM:
        raise Refused("not_finite", "the cloud holds points with infinite, absurd or partly missing coordinates")
    valid = len(flat) - np.count_nonzero(missing) // 3
    if valid < MIN_POINTS:
        raise Refused("too_few_points", f"the cloud holds {valid} valid points, at least {MIN_POINTS} are needed")
    some = flat if valid < SAMPLE else flat[:: max(1, len(flat) // (4 * SAMPLE))]
    some = some[some[:, 0] == some[:, 0]]
    _in_millimetres(some[:: max(1, len(some) // SAMPLE)])
    single = array.ndim == 3 and min(array.shape[:2]) == 1
    return Cloud(flat[~missing[:, 0]] if single else array)


def _in_millimetres(valid: NDArray[np.float32]) -> None:
    """Refuse what spans or lies where no joint in millimetres does."""
    low, high = np.percentile(valid, [5.0, 95.0], axis=0)
    span = float(np.max(high - low))
    if span < SMALLEST_SPAN_MM:
        raise Refused("wrong_unit", f"the cloud spans {span:.3g} mm: the file is probably in metres")
    if span > LARGEST_SPAN_MM:
        raise Refused("wrong_unit", f"the cloud spans {span:.3g} mm: the file is probably in micrometres")
    away = float(np.abs([low, high]).max())
    if away > FARTHEST_MM:
        raise Refused("out_of_range", f"the cloud lies {away:.3g} mm from its origin, at most {FARTHEST_MM:g} mm count")


def load_cloud(path: Path) -> Cloud:
    """Cloud from a file. Raises Unreadable, or Refused (not_finite, too_few_points, wrong_unit, out_of_range).

    NaN marks an invalid pixel of an organised cloud (and of PCD, whose writers use it); elsewhere it is refused.
    """
    kind = path.suffix.lower()
    if kind not in READERS:
        known = ", ".join(sorted(suffix[1:] for suffix in READERS))
        raise Unreadable(f"unknown kind of file '{kind}', known: {known}", place=path.name)
    try:
        points = READERS[kind](_content(path))
    except (OSError, ValueError, MemoryError) as error:
        raise Unreadable(str(error) or type(error).__name__, place=path.name) from None
    if points.ndim == 2:
        if kind == ".pcd":
            points = points[~np.isnan(points).all(axis=1)]
        elif not (finite := np.isfinite(points).all(axis=1)).all():
            raise Refused("not_finite", f"{int((~finite).sum())} of {len(points)} points are not finite")
    return as_cloud(points)


def _content(path: Path) -> bytes:
    """All bytes of a regular file. Raises OSError, or ValueError where that is none or it is too large."""
    if path.exists() and not path.is_file():
        raise ValueError("this is no regular file")
    size = path.stat().st_size
    if size > formats.MAX_BYTES:
        raise ValueError(f"the file has {size} bytes, at most {formats.MAX_BYTES} are read")
    return path.read_bytes()
