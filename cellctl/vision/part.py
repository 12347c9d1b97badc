"""What the vision core is told about a part, and what it says about it. Millimetres and degrees throughout.

Part frame: origin at the pattern's centre on the face, z the outward normal (out of the part, towards the scanner),
x through the pattern's zero angle. Nominal angles are right-handed about that z.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Refused(Exception):
    """The measurement is refused: `code` is stable, `reason` is one sentence. There is never a pose beside it.

    Codes: too_few_points, not_finite, wrong_unit, too_coarse, too_noisy, out_of_range, face_not_found, face_warped,
    features_missing, wrong_part, pattern_ambiguous, thread_wrong, artefact_moved, frames_disagree, not_measurable.
    """

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(f"{code}: {reason}")
        self.code = code
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Thread:
    """A 60 degree thread. `major_diameter_mm` is the crest diameter of the external thread."""

    major_diameter_mm: float
    pitch_mm: float
    hand: Literal["right", "left"] = "right"
    starts: int = 1


@dataclass(frozen=True, slots=True)
class Part:
    """Nominal geometry of one side of the joint. None means: not given, estimated or not used."""

    feature: Literal["hole", "stud"]
    circle_diameter_mm: float
    angles_deg: tuple[float, ...]
    index_feature: int | None = None
    diameter_mm: tuple[float, ...] | None = None
    chamfer_diameter_mm: float | None = None
    chamfer_angle_deg: float | None = None
    depth_mm: float | None = None
    length_mm: float | None = None
    thread: Thread | None = None
    face_inner_diameter_mm: float | None = None
    face_outer_diameter_mm: float | None = None
    ledge_step_mm: float | None = None
    flatness_limit_mm: float | None = None
    spigot_diameter_mm: float | None = None

    @property
    def count(self) -> int:
        """Number of features in the pattern."""
        return len(self.angles_deg)


@dataclass(frozen=True, slots=True)
class FaceFit:
    """A face plane. `point_mm` (3,) on it, unit `normal` (3,) out of the part.

    `covariance` (3, 3): offset along the normal at `point_mm` (mm2) and the two tilts (rad2) about the directions
    `tilt_axes` (2, 3). `sigma_mm` is the robust residual scale, `flatness_mm` the peak-to-valley of the smoothed
    face, `inliers` the share of the face's points kept.
    """

    point_mm: Array
    normal: Array
    tilt_axes: Array
    covariance: Array
    sigma_mm: float
    flatness_mm: float
    points: int
    inliers: float


@dataclass(frozen=True, slots=True)
class ThreadFit:
    """A thread as measured, with one-sigma uncertainties. `sigma_*` are type A."""

    radius_mm: float
    pitch_mm: float
    hand: Literal["right", "left"]
    starts: int
    phase_rad: float
    sigma_radius_mm: float
    sigma_pitch_mm: float


@dataclass(frozen=True, slots=True)
class FeatureFit:
    """One hole or stud. `center_mm` is where its axis meets the face plane; None where it was not found.

    `covariance_mm2` (3, 3) is type A, of `center_mm`; `reason` says why it was not found. `chamfer_radius_mm` is where
    the chamfer meets the face, None where none was fitted. `pivot_mm` is the height above the face, along its outward
    normal, at which the axis is known best: its place there and its lean (`axis_sigma_deg` in each direction) are
    independent, so a height z has the variance (c - pivot^2 lean^2) + (z - pivot)^2 lean^2 with c that of the centre.
    """

    index: int
    found: bool
    center_mm: Array | None = None
    axis: Array | None = None
    radius_mm: float | None = None
    covariance_mm2: Array | None = None
    axis_sigma_deg: float | None = None
    pivot_mm: float = 0.0
    thread: ThreadFit | None = None
    points: int = 0
    residual_mm: float = float("nan")
    reason: str = ""
    chamfer_radius_mm: float | None = None


def pivot(covariance: Array) -> float:
    """`FeatureFit.pivot_mm` from the covariance (4, 4) of the place on the face (2, mm) and of the slopes (2)."""
    lean = float(np.trace(covariance[2:, 2:]))
    return -float(np.trace(covariance[:2, 2:])) / lean if lean > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class PartMeasurement:
    """One part, measured. `T_frame_part` (4, 4) carries the part into `frame`.

    `covariance` (6, 6): type A of the part's pose, order x, y, z (mm2) then rx, ry, rz (rad2), in the part frame.
    `clocking_free` is true when no index feature fixed which feature is number 0 (x is then the nearest equivalent
    to the input's x axis).
    """

    frame: Literal["cell", "input"]
    feature: Literal["hole", "stud"]
    face: FaceFit
    T_frame_part: Array
    covariance: Array
    sigma_clocking_deg: float
    clocking_free: bool
    features: tuple[FeatureFit, ...]
    circle_diameter_mm: float
    quality: dict[str, float] = field(default_factory=dict)
    ledge_step_mm: float | None = None

    @property
    def found(self) -> int:
        """How many features were found."""
        return sum(feature.found for feature in self.features)
