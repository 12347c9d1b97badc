"""Where a ray meets a threaded stud, and how that depth moves with the stud's parameters. Pure and vectorised.

Each stud's frame: s along its axis from the face to the tip, phi = atan2(y, x). A thread ridge is the intersection of
half spaces: the crest cylinder r <= R, the two 60 degree flanks (ISO 68-1), the lead-in cone and the flat tip. A ray
enters the ridge where it has entered all of them, so the depth is the largest of their entries, unless it meets the
root's cylinder before; that depth is compared with the measured one, which keeps the crest free of the bias of a
linearised distance to the helix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

FLANK = float(np.sqrt(3.0))
"""|dr/ds| of a 60 degree thread's flank."""
ROOT_PITCHES = 0.613
"""Depth of an external thread in pitches (d3 of ISO 965-1): where a fit begins."""
CREST, UPPER, LOWER, ROOT, LEAD_IN, TIP = range(6)
OWN = 6
"""Parameters of one stud: axis x, y at s = 0 (mm), its slopes dx/ds, dy/ds, phase (mm along s), height at which the
lead-in leaves the crest (mm)."""
SHARED = 5
"""Parameters that alike studs share: crest radius R, half crest width w, pitch P (mm), fall -dr/ds of the lead-in,
root radius (mm)."""
RADIUS, CREST_WIDTH, PITCH, FALL, ROOT_RADIUS = range(SHARED)
BLOCK = 4096


@dataclass(frozen=True, slots=True)
class Rays:
    """Measured points (3, N) with unit rays (3, N) that point away from the camera, and the stud (N,) each is on."""

    points: Array
    directions: Array
    stud: Indices

    def take(self, rows: Indices | slice) -> Rays:
        """The chosen points only."""
        return Rays(self.points[:, rows], self.directions[:, rows], self.stud[rows])


@dataclass(frozen=True, slots=True)
class Form:
    """What is known of the thread: hand (+1 right, -1 left, 0 a plain pin), starts, height of reference, tip (n,), and
    by how much each stud's radius exceeds the shared one (n,)."""

    hand: int
    starts: int
    middle_mm: float
    tip_mm: Array
    extra_mm: Array


@dataclass(frozen=True, slots=True)
class Depths:
    """`ahead_mm` (N,) predicted minus measured depth along the ray, NaN where the ray misses; the surface met (N,);
    derivatives (OWN + SHARED, N); cosine of incidence (N,); how far the place met lies below the crest (N,)."""

    ahead_mm: Array
    surface: NDArray[np.int8]
    slopes: Array
    cosine: Array
    below_mm: Array

    def take(self, rows: Indices | slice) -> Depths:
        """The chosen points only."""
        return Depths(
            self.ahead_mm[rows], self.surface[rows], self.slopes[:, rows], self.cosine[rows], self.below_mm[rows]
        )


def depths(rays: Rays, own: Array, shared: Array, form: Form) -> Depths:
    """Predict the depth of every ray for stud parameters `own` (n, OWN) and `shared` (SHARED,).

    Block by block, so that what is worked on stays in the processor's cache.
    """
    count = len(rays.stud)
    if count <= BLOCK:
        return _depths(rays, own, shared, form)
    whole = Depths(
        np.empty(count), np.empty(count, np.int8), np.empty((OWN + SHARED, count)), np.empty(count), np.empty(count)
    )
    for begin in range(0, count, BLOCK):
        rows = slice(begin, begin + BLOCK)
        part = _depths(rays.take(rows), own, shared, form)
        whole.ahead_mm[rows], whole.surface[rows], whole.slopes[:, rows] = part.ahead_mm, part.surface, part.slopes
        whole.cosine[rows], whole.below_mm[rows] = part.cosine, part.below_mm
    return whole


def _depths(rays: Rays, own: Array, shared: Array, form: Form) -> Depths:
    track = _Track.of(rays, own, shared, form)
    entries = np.full((6, len(rays.stud)), -np.inf)
    entries[CREST] = track.cylinder_entry(track.radius)
    entries[LEAD_IN] = track.lead_in_entry()
    entries[TIP] = np.where(track.ds < -0.02, (form.tip_mm[rays.stud] - track.s) / np.minimum(track.ds, -0.02), -np.inf)
    ridge = angle = np.zeros(0)
    if form.hand:
        ridge, sign = track.ridge(entries.max(axis=0))
        entry, angle = track.flank_entry(ridge, sign)
        entries[UPPER] = np.where(sign > 0.0, entry, -np.inf)
        entries[LOWER] = np.where(sign < 0.0, entry, -np.inf)
    met = entries.argmax(axis=0).astype(np.int8)
    ahead = entries.max(axis=0)
    if form.hand and (np.abs(track.ds) < track.across).any():
        # steeper rays meet the next ridge before they come down to the root
        root = np.maximum(track.cylinder_entry(track.root), np.maximum(entries[LEAD_IN], entries[TIP]))
        met = np.where(root < ahead, np.int8(ROOT), met)
        ahead = np.minimum(ahead, root)
    return track.derivatives(np.where(np.isfinite(ahead), ahead, np.nan), met, ridge, angle)


@dataclass(frozen=True, slots=True)
class _Track:
    """Each ray in its stud's own frame: position x, y, s at the measured point and change dx, dy, ds per mm along it.

    `across` (N,) is the length of (dx, dy), `angle` (N,) phi at the measured point, `radius` and `root` (N,) are each
    stud's crest and root.
    """

    x: Array
    y: Array
    s: Array
    dx: Array
    dy: Array
    ds: Array
    across: Array
    phase: Array
    lead_in: Array
    radius: Array
    root: Array
    half_crest: float
    pitch: float
    fall: float
    lead: float
    angle: Array

    @classmethod
    def of(cls, rays: Rays, own: Array, shared: Array, form: Form) -> _Track:
        common, half_crest, pitch, fall, root = (float(value) for value in shared)
        x0, y0, slope_x, slope_y, phase, lead_in = own.T.take(rays.stud, axis=1)
        (x, y, s), (dx, dy, ds) = rays.points, rays.directions
        x, y = x - x0 - slope_x * s, y - y0 - slope_y * s
        dx, dy = dx - slope_x * ds, dy - slope_y * ds
        s, ds = s + slope_x * x + slope_y * y, ds + slope_x * dx + slope_y * dy
        lead = form.hand * form.starts * pitch / (2.0 * np.pi)
        extra = form.extra_mm[rays.stud]
        across = np.sqrt(dx * dx + dy * dy)
        phase = phase + form.middle_mm
        angle = np.arctan2(y, x) if form.hand else x
        return cls(
            x, y, s, dx, dy, ds, across, phase, lead_in, common + extra, root + extra, half_crest, pitch, fall, lead,
            angle,
        )  # fmt: skip

    def angle_at(self, x: Array, y: Array) -> Array:
        """phi (N,) at places not far from the measured ones: the turn between them to fifth order."""
        tangent = (self.x * y - self.y * x) / (self.x * x + self.y * y)
        return self.angle + tangent * (1.0 - tangent * tangent * (1.0 / 3.0))

    def ridge(self, envelope: Array) -> tuple[Array, Array]:
        """Number (N,) of the ridge that each ray meets, and the slope of its flank there: FLANK the upper, -FLANK the
        lower one. `envelope` (N,) is where the ray enters crest, lead-in and tip.

        A ray that enters beside a ridge comes down in a valley, between the lower flank of the ridge above and the
        upper flank of the one below, and meets the one that closes first. That does not depend on the measured depth,
        whose noise on a crest seen at a grazing angle reaches from one ridge to the next.
        """
        at = np.where(np.isfinite(envelope), envelope, 0.0)
        x, y = self.x + at * self.dx, self.y + at * self.dy
        r = np.maximum(np.sqrt(x * x + y * y), 0.05)
        turns = (self.s + at * self.ds - self.phase - self.lead * self.angle_at(x, y)) / self.pitch
        nearest = np.rint(turns)
        off = turns - nearest
        half = (self.half_crest + (self.radius - r) / FLANK) / self.pitch
        along = self.ds - self.lead * (x * self.dy - y * self.dx) / r**2
        steep = along / np.minimum((x * self.dx + y * self.dy) / r, -1e-6)
        above, below = np.where(off > 0.0, 1.0 - off, -off) - half, np.where(off > 0.0, off, 1.0 + off) - half
        # each flank is met at the depth: room over how fast it closes, 1 / FLANK less or more than the ray descends
        up = above * (1.0 / FLANK + steep) < below * (1.0 / FLANK - steep)
        beside = np.abs(off) > half
        valley = np.where(off > 0.0, nearest, nearest - 1.0) + up
        return np.where(beside, valley, nearest), np.where(beside & up, -FLANK, FLANK)

    def cylinder_entry(self, radius: Array) -> Array:
        """Where the ray enters r = `radius` (N,); infinite where it passes beside."""
        a, b = self.across**2, self.x * self.dx + self.y * self.dy
        square = b * b - a * (self.x**2 + self.y**2 - radius**2)
        root = np.sqrt(np.maximum(square, 0.0))
        entry = np.where(a > 1e-12, (-b - root) / np.maximum(a, 1e-12), -np.inf)
        return np.asarray(np.where(square > 0, entry, np.inf))

    def lead_in_entry(self) -> Array:
        """Where the ray enters the cone r = R - fall (s - lead_in); -inf where it does not."""
        room = self.radius - self.fall * (self.s - self.lead_in)
        a = self.across**2 - (self.fall * self.ds) ** 2
        b = self.x * self.dx + self.y * self.dy + room * self.fall * self.ds
        square = b * b - a * (self.x**2 + self.y**2 - room**2)
        root = np.sqrt(np.maximum(square, 0.0))
        # both roots have the same product; this one does not cancel where the cone is entered near the point
        entry = (self.x**2 + self.y**2 - room**2) / np.maximum(root - b, 1e-9)
        inside = (square > 0) & (b < 0.9 * root) & (room - entry * self.fall * self.ds > 0.0)
        return np.asarray(np.where(inside, entry, -np.inf))

    def flank_entry(self, ridge: Array, sign: Array) -> tuple[Array, Array]:
        """Entry into the half space of each ray's flank near the measured point, -inf where it leaves it; its phi."""
        offset = self.phase + ridge * self.pitch
        level = FLANK * self.half_crest + self.radius
        at = np.zeros(len(self.x))
        enters = np.ones(len(self.x), dtype=np.bool_)
        for _ in range(2):
            x, y = self.x + at * self.dx, self.y + at * self.dy
            r = np.maximum(np.sqrt(x * x + y * y), 0.05)
            angle = self.angle_at(x, y)
            turn = (x * self.dy - y * self.dx) / r**2
            height = sign * (self.s + at * self.ds - offset - self.lead * angle) + r - level
            slope = (x * self.dx + y * self.dy) / r + sign * (self.ds - self.lead * turn)
            enters &= slope < -0.05
            step = np.clip(-height / np.where(enters, slope, -1.0), -2.0, 2.0)
            at = at + np.where(enters, step, 0.0)
        return np.where(enters, at, -np.inf), angle + turn * np.where(enters, step, 0.0)

    def derivatives(self, ahead: Array, met: NDArray[np.int8], ridge: Array, angle: Array) -> Depths:
        """Implicit derivatives of the depth at the surface that each ray meets: -(dF/dq) / (dF/d depth)."""
        at = np.where(np.isfinite(ahead), ahead, 0.0)
        x, y, s = self.x + at * self.dx, self.y + at * self.dy, self.s + at * self.ds
        r = np.maximum(np.sqrt(x * x + y * y), 0.05)
        lead_in, tip, root = met == LEAD_IN, met == TIP, met == ROOT
        sign = np.where(met == UPPER, FLANK, np.where(met == LOWER, -FLANK, 0.0))
        radial = np.where(tip, 0.0, 1.0)
        turn = sign * self.lead / r**2
        gx, gy = radial * x / r + turn * y, radial * y / r - turn * x
        gs = sign + np.where(lead_in, self.fall, np.where(tip, 1.0, 0.0))
        slope = gx * self.dx + gy * self.dy + gs * self.ds
        slope = np.where(np.abs(slope) > 1e-3, slope, -1e-3)
        scale = 1.0 / slope
        columns = np.empty((OWN + SHARED, len(x)))
        columns[0], columns[1] = gx * scale, gy * scale
        columns[2], columns[3] = (s * gx - x * gs) * scale, (s * gy - y * gs) * scale
        columns[4] = sign * scale
        columns[5] = np.where(lead_in, self.fall, 0.0) * scale
        columns[OWN + RADIUS] = np.where(root, 0.0, radial) * scale
        columns[OWN + CREST_WIDTH] = np.abs(sign) * scale
        columns[OWN + PITCH] = columns[4] * (self.lead / self.pitch * angle + ridge) if len(ridge) else 0.0
        columns[OWN + FALL] = np.where(lead_in, self.lead_in - s, 0.0) * scale
        columns[OWN + ROOT_RADIUS] = np.where(root, scale, 0.0)
        cosine = np.abs(slope) / np.sqrt(gx**2 + gy**2 + gs**2)
        return Depths(ahead, met, columns, cosine, self.radius - r)
