"""The structured-light camera as an instrument: its pixel grid, its eyes, its range. Scanner frame, millimetres.

Scanner frame: origin at the pinhole of the pixel grid (the projector), z away from the camera, x along the columns
and y along the rows. A pixel is named by its slopes (u, v) = (x/z, y/z); the ray is (u, v, 1) and its parameter is
the depth z. Two eyes beside the projector must see a point too. The numbers are those of a common compact
structured-light scanner used at 300-400 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Camera:
    """Pixel grid of `rows` x `cols` and what surrounds it."""

    rows: int = 707
    cols: int = 707
    half_width: float = 165.0 / 350.0
    """Slope of the outermost pixel in a row or column: 165 mm at 350 mm."""
    eyes_mm: tuple[tuple[float, float, float], ...] = ((-45.0, 0.0, 0.0), (45.0, 0.0, 0.0))
    near_mm: float = 280.0
    far_mm: float = 430.0
    """Outside these depths nothing is in focus and nothing is measured."""
    reference_mm: float = 350.0
    """Depth at which the noise is stated."""

    @property
    def pitch(self) -> float:
        """Slope from one pixel to the next."""
        return 2.0 * self.half_width / (max(self.rows, self.cols) - 1)

    def slopes(self) -> tuple[Array, Array]:
        """u and v of every pixel, each (rows * cols,), row by row."""
        u = (np.arange(self.cols) - 0.5 * (self.cols - 1)) * self.pitch
        v = (np.arange(self.rows) - 0.5 * (self.rows - 1)) * self.pitch
        return np.tile(u, self.rows), np.repeat(v, self.cols)

    def windows(self, low: Array, high: Array, margin_px: float = 1.5) -> tuple[Indices, Indices]:
        """Pixels inside boxes of slopes `low` (n, 2) to `high` (n, 2): flat pixel indices and the box of each.

        A pixel that lies in several boxes is listed for each of them.
        """
        center = 0.5 * np.array([self.cols - 1, self.rows - 1])
        size = np.array([self.cols, self.rows])
        first = np.clip(np.floor(low / self.pitch + center - margin_px), 0, size).astype(int)
        last = np.clip(np.ceil(high / self.pitch + center + margin_px) + 1, 0, size).astype(int)
        pixels, boxes = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.intp)]
        for box, ((c0, r0), (c1, r1)) in enumerate(zip(first, last, strict=True)):
            if c1 > c0 and r1 > r0:
                inside = (np.arange(r0, r1)[:, None] * self.cols + np.arange(c0, c1)[None, :]).ravel()
                pixels.append(inside)
                boxes.append(np.full(inside.size, box, dtype=np.intp))
        return np.concatenate(pixels), np.concatenate(boxes)


def camera_for(points: int) -> Camera:
    """The square grid with about `points` pixels."""
    side = max(2, round(points**0.5))
    return Camera(rows=side, cols=side)


@dataclass(frozen=True, slots=True)
class ScanErrors:
    """What the instrument does to a perfect cloud; every strength is a number here.

    `scale` and the ripple's phase belong to the instrument and stay the same from scan to scan.
    """

    noise_mm: float = 0.03
    """One sigma along the ray at normal incidence and `Camera.reference_mm`; grows with depth squared and with one
    over the cosine of the incidence angle."""
    correlation_px: float = 3.0
    """Distance at which the noise's correlation has fallen to 1/e; 0 for white noise."""
    ripple_mm: float = 0.010
    """One sigma over the picture of the long-wave fringe error along the ray: a sine of sqrt(2) times this."""
    ripple_wavelength_mm: float = 62.0
    ripple_angle_deg: float = 20.0
    ripple_phase_deg: float = 0.0
    scale: float = 50e-6
    """Relative scale error, signed."""
    outliers: float = 0.02
    """Share of the measured pixels that carry a wrong depth."""
    outlier_depth_mm: float = 8.0
    """Scale of their (Laplace) error."""
    edge_step_mm: float = 1.5
    """Neighbours further apart in depth than this form a depth edge."""
    flying: float = 0.3
    """Share of the pixels at a depth edge that fly between the two surfaces."""
    steep_deg: float = 75.0
    """Surfaces seen at a steeper incidence give no data."""
    eye_steep_deg: float = 82.0
    """The same for each eye."""
    glare_deg: float = 2.0
    """A mirror direction within this angle of the surface normal saturates the eye."""
    bands: int = 2
    """Bands of stray light across the image."""
    band_width: float = 0.03
    """Width of a band as a share of the image."""
    band_noise: float = 2.0
    """Factor on the noise inside a band."""
    band_loss: float = 0.2
    """Share of the pixels lost inside a band."""


IDEAL = ScanErrors(
    noise_mm=0.0,
    correlation_px=0.0,
    ripple_mm=0.0,
    scale=0.0,
    outliers=0.0,
    flying=0.0,
    bands=0,
)
"""A perfect instrument that still cannot look around corners."""
