"""True shapes of what stands before the camera: plain frozen data. Part frame: z the outward normal, face at z = 0."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.fake.scene.thread_form import StudForm

Array = NDArray[np.float64]


def _empty(*shape: int) -> Array:
    return np.empty(shape)


@dataclass(frozen=True, slots=True)
class Holes:
    """Through-holes with a chamfered mouth. `center_mm` (n, 2) where the axis meets the face, `axis` (n, 3) unit, out
    of the part; `radius_mm`, `mouth_radius_mm` (n,)."""

    center_mm: Array
    axis: Array
    radius_mm: Array
    mouth_radius_mm: Array
    chamfer_tan: float
    """Tangent of the chamfer's half angle."""
    depth_mm: float


@dataclass(frozen=True, slots=True)
class Studs:
    """Threaded studs standing on the face. `center_mm` (n, 2), `axis` (n, 3) unit, `phase` (n,) in turns: the crest's
    place at the face, in pitches, in the stud's frame (see `frame_on`)."""

    center_mm: Array
    axis: Array
    phase: Array
    form: StudForm


@dataclass(frozen=True, slots=True)
class PartShape:
    """One side of the joint: coaxial rings and bevels, a bore, and holes or studs."""

    rings_mm: tuple[tuple[float, float, float], ...]
    """Flat annuli (inner radius, outer radius, z), the one nearest to the camera first."""
    bevels_mm: tuple[tuple[float, float, float, float], ...] = ()
    """Cones between (radius, z) and (radius, z)."""
    bore_mm: tuple[float, float, float] | None = None
    """Cylinder seen from inside: radius, upper z, lower z."""
    holes: Holes | None = None
    studs: Studs | None = None

    @property
    def count(self) -> int:
        """Number of features."""
        return sum(len(some.center_mm) for some in (self.holes, self.studs) if some is not None)


@dataclass(frozen=True, slots=True)
class Clutter:
    """What else is in view: spheres of the artefact, and round bars with flat ends (posts, stems, clamps, pipes).

    `bars_mm` (m, 2, 3) are the centres of the ends. In the cell frame as data, in the scanner frame once `moved`.
    """

    spheres_mm: Array = field(default_factory=lambda: _empty(0, 3))
    sphere_radius_mm: float = 10.0
    bars_mm: Array = field(default_factory=lambda: _empty(0, 2, 3))
    bar_radius_mm: Array = field(default_factory=lambda: _empty(0))

    def moved(self, T: Array) -> Clutter:
        """The same things in another frame."""
        return Clutter(
            spheres_mm=self.spheres_mm @ T[:3, :3].T + T[:3, 3],
            sphere_radius_mm=self.sphere_radius_mm,
            bars_mm=self.bars_mm @ T[:3, :3].T + T[:3, 3],
            bar_radius_mm=self.bar_radius_mm,
        )


def frame_on(axis: Array) -> Array:
    """(n, 3, 3) rows x, y, z of feature frames with z along `axis` (n, 3); x is the part's x made normal to it."""
    x = np.array([1.0, 0.0, 0.0]) - axis[:, :1] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axis, x), axis], axis=1)
