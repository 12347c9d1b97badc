"""Where a ray meets a threaded stud, and how that depth moves with the stud's parameters. Pure and vectorised.

Each stud's frame: s along its axis from the face to the tip, phi = atan2(y, x). A thread ridge is the intersection of
half spaces: the crest cylinder r <= R, the two 60 degree flanks (ISO 68-1), the 45 degree lead-in cone and the flat
tip. A ray enters the ridge where it has entered all of them, so the depth is the largest of their entries; that depth
is compared with the measured one, which keeps the crest free of the bias of a linearised distance to the helix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

FLANK = float(np.sqrt(3.0))
"""|dr/ds| of a 60 degree thread's flank."""
CREST, UPPER, LOWER, LEAD_IN, TIP = range(5)
OWN = 6
"""Parameters of one stud: axis x, y at s = 0 (mm), its slopes dx/ds, dy/ds, phase (mm along s), lead-in r + s (mm)."""
SHARED = 3
"""Parameters that alike studs share: crest radius R, half crest width w, pitch P (mm)."""


@dataclass(frozen=True, slots=True)
class Rays:
    """Measured points (N, 3) with unit rays (N, 3) that point away from the camera, and the stud (N,) each is on."""

    points: Array
    directions: Array
    stud: Indices

    def take(self, rows: Indices) -> Rays:
        """The chosen points only."""
        return Rays(self.points[rows], self.directions[rows], self.stud[rows])


@dataclass(frozen=True, slots=True)
class Form:
    """What is known of the thread: hand (+1 right, -1 left, 0 a plain pin), starts, height of reference, tip (n,)."""

    hand: int
    starts: int
    middle_mm: float
    tip_mm: Array


@dataclass(frozen=True, slots=True)
class Depths:
    """`ahead_mm` (N,) predicted minus measured depth along the ray, NaN where the ray misses; the surface met (N,);
    derivatives (N, OWN), (N, SHARED); cosine of incidence (N,); how far the place met lies below the crest (N,)."""

    ahead_mm: Array
    surface: NDArray[np.int8]
    own: Array
    shared: Array
    cosine: Array
    below_mm: Array


def depths(rays: Rays, own: Array, shared: Array, form: Form) -> Depths:
    """Predict the depth of every ray for stud parameters `own` (n, OWN) and `shared` (SHARED,)."""
    track = _Track.of(rays, own, shared, form)
    entries = np.full((5, len(rays.stud)), -np.inf)
    entries[CREST] = track.crest_entry()
    entries[TIP] = (form.tip_mm[rays.stud] - track.s) / np.where(track.ds < -0.05, track.ds, -np.inf)
    entries[LEAD_IN] = track.entry(LEAD_IN)
    if form.hand:
        shallow = FLANK * np.abs(track.ds) < np.hypot(track.dx, track.dy)
        track = track.on_ridge(entries.max(axis=0), shallow)
        entries[UPPER] = track.entry(UPPER)
        if shallow.any():
            entries[LOWER] = track.entry(LOWER)
    met = entries.argmax(axis=0).astype(np.int8)
    ahead = entries.max(axis=0)
    return track.derivatives(np.where(np.isfinite(ahead), ahead, np.nan), met)


@dataclass(frozen=True, slots=True)
class _Track:
    """Each ray in its stud's own frame: position x, y, s at the measured point and change dx, dy, ds per mm along it.

    `ridge` (N,) is the number of the thread's ridge that the ray meets.
    """

    x: Array
    y: Array
    s: Array
    dx: Array
    dy: Array
    ds: Array
    phase: Array
    lead_in: Array
    ridge: Array
    radius: float
    half_crest: float
    pitch: float
    lead: float

    @classmethod
    def of(cls, rays: Rays, own: Array, shared: Array, form: Form) -> _Track:
        radius, half_crest, pitch = (float(value) for value in shared)
        a = own[rays.stud]
        s, ds = rays.points[:, 2], rays.directions[:, 2]
        x = rays.points[:, 0] - a[:, 0] - a[:, 2] * s
        y = rays.points[:, 1] - a[:, 1] - a[:, 3] * s
        dx, dy = rays.directions[:, 0] - a[:, 2] * ds, rays.directions[:, 1] - a[:, 3] * ds
        s, ds = s + a[:, 2] * x + a[:, 3] * y, ds + a[:, 2] * dx + a[:, 3] * dy
        lead = form.hand * form.starts * pitch / (2.0 * np.pi)
        phase = form.middle_mm + a[:, 4]
        return cls(x, y, s, dx, dy, ds, phase, a[:, 5], np.zeros(len(s)), radius, half_crest, pitch, lead)

    def on_ridge(self, envelope: Array, shallow: NDArray[np.bool_]) -> _Track:
        """The same rays with the ridge that each meets; `envelope` (N,) is where they enter crest, lead-in and tip.

        A ray that comes down on the thread meets the ridge it is in when it enters the envelope, or the next below.
        That does not depend on the measured depth, whose noise on a crest seen at a grazing angle reaches from one
        ridge to the next. A shallow ray may meet either flank of a valley: the ridge nearest to the measured point.
        """
        at = np.where(shallow | ~np.isfinite(envelope), 0.0, envelope)
        x, y = self.x + at * self.dx, self.y + at * self.dy
        turns = (self.s + at * self.ds - self.phase - self.lead * np.arctan2(y, x)) / self.pitch
        half = (self.half_crest + (self.radius - np.hypot(x, y)) / FLANK) / self.pitch
        return replace(self, ridge=np.where(shallow, np.rint(turns), np.floor(turns + np.maximum(half, 0.0))))

    def crest_entry(self) -> Array:
        """Where the ray enters r = R; infinite where it passes beside."""
        a, b = self.dx**2 + self.dy**2, self.x * self.dx + self.y * self.dy
        square = b * b - a * (self.x**2 + self.y**2 - self.radius**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            entry = np.where(a > 1e-12, (-b - np.sqrt(np.maximum(square, 0.0))) / a, -np.inf)
        return np.asarray(np.where(square > 0, entry, np.inf))

    def entry(self, surface: int) -> Array:
        """Entry into the half space of a flank or the lead-in near the measured point; -inf where the ray leaves it."""
        at = np.zeros(len(self.x))
        enters = np.ones(len(self.x), dtype=np.bool_)
        for _ in range(3):
            height, slope = self._height(surface, at)
            enters &= slope < -0.05
            at = at - np.where(enters, np.clip(height / np.where(enters, slope, -1.0), -2.0, 2.0), 0.0)
        return np.where(enters, at, -np.inf)

    def _height(self, surface: int, at: Array) -> tuple[Array, Array]:
        """Height above the surface at `at` along the ray (radial units), and its slope along the ray."""
        x, y, s = self.x + at * self.dx, self.y + at * self.dy, self.s + at * self.ds
        r = np.maximum(np.hypot(x, y), 0.05)
        rise = (x * self.dx + y * self.dy) / r
        if surface == LEAD_IN:
            return r + s - self.lead_in, rise + self.ds
        sign = FLANK if surface == UPPER else -FLANK
        t = s - self.phase - self.lead * np.arctan2(y, x) - self.ridge * self.pitch
        turn = (x * self.dy - y * self.dx) / r**2
        return sign * t - FLANK * self.half_crest + r - self.radius, rise + sign * (self.ds - self.lead * turn)

    def derivatives(self, ahead: Array, met: NDArray[np.int8]) -> Depths:
        """Implicit derivatives of the depth at the surface that each ray meets: -(dF/dq) / (dF/d depth)."""
        at = np.nan_to_num(ahead)
        x, y, s = self.x + at * self.dx, self.y + at * self.dy, self.s + at * self.ds
        r = np.maximum(np.hypot(x, y), 0.05)
        sign = np.where(met == UPPER, FLANK, np.where(met == LOWER, -FLANK, 0.0))
        radial = (met != TIP).astype(np.float64)
        gx = radial * x / r + sign * self.lead * y / r**2
        gy = radial * y / r - sign * self.lead * x / r**2
        gs = sign + ((met == LEAD_IN) | (met == TIP))
        slope = gx * self.dx + gy * self.dy + gs * self.ds
        slope = np.where(np.abs(slope) > 1e-3, slope, -1e-3)
        turns = self.lead / self.pitch * np.arctan2(y, x) + self.ridge
        own = np.stack(
            [-gx, -gy, x * gs - s * gx, y * gs - s * gy, -sign, -(met == LEAD_IN).astype(np.float64)], axis=1
        )
        on_thread = (met <= LOWER).astype(np.float64)
        shared = np.stack([-on_thread, -np.abs(sign), -sign * turns], axis=1)
        cosine = np.abs(slope) / np.sqrt(gx**2 + gy**2 + gs**2)
        slope = -slope[:, None]
        return Depths(ahead, met, own / slope, shared / slope, np.asarray(cosine), self.radius - r)
