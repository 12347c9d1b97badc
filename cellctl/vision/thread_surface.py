"""Where a ray meets a threaded stud, and how that depth moves with the stud's parameters. Pure and vectorised.

Each stud's frame: s along its axis from the face to the tip, phi = atan2(y, x). A thread ridge is the intersection of
half spaces: the crest cylinder r <= R, the two 60 degree flanks (ISO 68-1), the lead-in cone and the flat tip. A ray
enters the ridge where it has entered all of them, so the depth is the largest of their entries, unless it meets the
root's cylinder before; that depth is compared with the measured one, which keeps the crest free of the bias of a
linearised distance to the helix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
SIZE = OWN + SHARED + 1
LEAST_R_MM = 0.05
"""Nearer to its axis no ray meets a thread."""
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
    rows (SIZE, N) of least squares: derivatives by own and shared parameters, then minus `ahead_mm`, 0 where that is
    NaN; cosine of incidence (N,); how far the place met lies below the crest (N,)."""

    ahead_mm: Array
    surface: NDArray[np.int8]
    rows: Array
    cosine: Array
    below_mm: Array

    def take(self, rows: Indices | slice) -> Depths:
        """The chosen points only."""
        return Depths(
            self.ahead_mm[rows], self.surface[rows], self.rows[:, rows], self.cosine[rows], self.below_mm[rows]
        )

    def moved(self, steps: tuple[Array, Array], stud: Indices) -> Depths:
        """After small steps of own (n, OWN) and shared (SHARED,) parameters: the rays meet the surfaces they met."""
        ahead = self.ahead_mm + np.einsum("kn,kn->n", self.rows[:OWN], steps[0].T.take(stud, axis=1))
        ahead += np.einsum("kn,k->n", self.rows[OWN:-1], steps[1])
        rows = np.concatenate([self.rows[:-1], np.where(np.isfinite(ahead), -ahead, 0.0)[None]])
        return replace(self, ahead_mm=ahead, rows=rows)


def depths(rays: Rays, own: Array, shared: Array, form: Form, *, rows: bool = True) -> Depths:
    """Predict the depth of every ray for stud parameters `own` (n, OWN) and `shared` (SHARED,); without `rows` where
    only that is asked.

    Block by block, so that what is worked on stays in the processor's cache.
    """
    count = len(rays.stud)
    if count <= BLOCK:
        return _depths(rays, own, shared, form, rows)
    whole = Depths(
        np.empty(count), np.empty(count, np.int8), np.empty((SIZE if rows else 0, count)), np.empty(count),
        np.empty(count),
    )  # fmt: skip
    for begin in range(0, count, BLOCK):
        block = slice(begin, begin + BLOCK)
        part = _depths(rays.take(block), own, shared, form, rows)
        whole.ahead_mm[block], whole.surface[block], whole.rows[:, block] = part.ahead_mm, part.surface, part.rows
        whole.cosine[block], whole.below_mm[block] = part.cosine, part.below_mm
    return whole


def _depths(rays: Rays, own: Array, shared: Array, form: Form, rows: bool) -> Depths:
    track = _Track.of(rays, own, shared, form)
    ahead, lead_in = track.cylinder_entry(track.radius), track.lead_in_entry()
    tip = np.where(track.ds < -0.02, (form.tip_mm[rays.stud] - track.s) / np.minimum(track.ds, -0.02), -np.inf)
    met = np.where(lead_in > ahead, np.int8(LEAD_IN), np.int8(CREST))
    ahead = np.maximum(ahead, lead_in)
    met = np.where(tip > ahead, np.int8(TIP), met)
    ahead = np.maximum(ahead, tip)
    ridge = angle = np.zeros(0)
    if form.hand:
        ridge, sign = track.ridge(ahead)
        flank, angle = track.flank_entry(ridge, sign)
        met = np.where(flank > ahead, np.where(sign > 0.0, np.int8(UPPER), np.int8(LOWER)), met)
        ahead = np.maximum(ahead, flank)
        if (np.square(track.ds) < track.flat).any():
            # steeper rays meet the next ridge before they come down to the root
            root = np.maximum(track.cylinder_entry(track.root), np.maximum(lead_in, tip))
            met = np.where(root < ahead, np.int8(ROOT), met)
            ahead = np.minimum(ahead, root)
    return track.meeting(np.where(np.isfinite(ahead), ahead, np.nan), met, ridge, angle, rows)


@dataclass(frozen=True, slots=True)
class _Track:
    """Each ray in its stud's own frame: position x, y, s at the measured point and change dx, dy, ds per mm along it.

    Of (x, y) and (dx, dy), which say all about distance and angle along the ray: `square` and `flat` (N,) are the
    squares, `inward` their product, `swirl` their cross product. `angle` (N,) is phi at the measured point, `radius`
    and `root` (N,) are each stud's crest and root.
    """

    x: Array
    y: Array
    s: Array
    dx: Array
    dy: Array
    ds: Array
    square: Array
    flat: Array
    inward: Array
    swirl: Array
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
        angle = np.arctan2(y, x) if form.hand else x
        return cls(
            x, y, s, dx, dy, ds, x * x + y * y, dx * dx + dy * dy, x * dx + y * dy, x * dy - y * dx,
            phase + form.middle_mm, lead_in, common + extra, root + extra, half_crest, pitch, fall, lead, angle,
        )  # fmt: skip

    def around(self, at: Array) -> tuple[Array, Array]:
        """Distance r (N,) from the axis and phi (N,) at places `at` (N,) along the rays, not far from the measured
        ones: the turn between them to fifth order."""
        r = np.sqrt(np.maximum(self.square + at * (2.0 * self.inward + at * self.flat), LEAST_R_MM**2))
        tangent = at * self.swirl / (self.square + at * self.inward)
        return r, self.angle + tangent * (1.0 - tangent * tangent * (1.0 / 3.0))

    def ridge(self, envelope: Array) -> tuple[Array, Array]:
        """Number (N,) of the ridge that each ray meets, and the slope of its flank there: FLANK the upper, -FLANK the
        lower one. `envelope` (N,) is where the ray enters crest, lead-in and tip.

        A ray that enters beside a ridge comes down in a valley, between the lower flank of the ridge above and the
        upper flank of the one below, and meets the one that closes first. That does not depend on the measured depth,
        whose noise on a crest seen at a grazing angle reaches from one ridge to the next.
        """
        at = np.where(np.isfinite(envelope), envelope, 0.0)
        r, angle = self.around(at)
        turns = (self.s + at * self.ds - self.phase - self.lead * angle) * (1.0 / self.pitch)
        nearest = np.rint(turns)
        off = turns - nearest
        half = (self.half_crest + (self.radius - r) * (1.0 / FLANK)) * (1.0 / self.pitch)
        steep = (self.ds - self.lead * self.swirl / r**2) / np.minimum((self.inward + at * self.flat) / r, -1e-6)
        below = off - np.floor(off)  # how far the ray is over the ridge below it, in pitches
        # each flank is met at the depth: room over how fast it closes, 1 / FLANK less or more than the ray descends
        up = (1.0 - below - half) * (1.0 / FLANK + steep) < (below - half) * (1.0 / FLANK - steep)
        beside = np.abs(off) > half
        return np.where(beside, nearest + np.floor(off) + up, nearest), np.where(beside & up, -FLANK, FLANK)

    def cylinder_entry(self, radius: Array) -> Array:
        """Where the ray enters r = `radius` (N,); infinite where it passes beside."""
        square = self.inward * self.inward - self.flat * (self.square - radius * radius)
        root = np.sqrt(np.maximum(square, 0.0))
        entry = np.where(self.flat > 1e-12, (-self.inward - root) / np.maximum(self.flat, 1e-12), -np.inf)
        return np.asarray(np.where(square > 0, entry, np.inf))

    def lead_in_entry(self) -> Array:
        """Where the ray enters the cone r = R - fall (s - lead_in); -inf where it does not."""
        room, closing = self.radius - self.fall * (self.s - self.lead_in), self.fall * self.ds
        a, b, c = self.flat - closing * closing, self.inward + room * closing, self.square - room * room
        square = b * b - a * c
        root = np.sqrt(np.maximum(square, 0.0))
        # both roots have the same product; this one does not cancel where the cone is entered near the point
        entry = c / np.maximum(root - b, 1e-9)
        inside = (square > 0) & (b < 0.9 * root) & (room - entry * closing > 0.0)
        return np.asarray(np.where(inside, entry, -np.inf))

    def flank_entry(self, ridge: Array, sign: Array) -> tuple[Array, Array]:
        """Entry into the half space of each ray's flank near the measured point, -inf where it leaves it; its phi."""
        level = FLANK * self.half_crest + self.radius
        height = sign * (self.s - self.phase - ridge * self.pitch) - level
        r, angle = np.sqrt(np.maximum(self.square, LEAST_R_MM**2)), self.angle
        at, enters = np.zeros(len(self.x)), np.ones(len(self.x), dtype=np.bool_)
        for last in (False, True):
            turn = self.swirl / (r * r)
            slope = (self.inward + at * self.flat) / r + sign * (self.ds - self.lead * turn)
            enters &= slope < -0.05
            miss = height + sign * (at * self.ds - self.lead * angle) + r
            step = np.where(enters, np.clip(miss / -np.where(enters, slope, -1.0), -2.0, 2.0), 0.0)
            at = at + step
            if not last:
                r, angle = self.around(at)
        return np.where(enters, at, -np.inf), angle + turn * step

    def meeting(self, ahead: Array, met: NDArray[np.int8], ridge: Array, angle: Array, rows: bool) -> Depths:
        """The depths at the surface that each ray meets, with their implicit derivatives: -(dF/dq) / (dF/d depth)."""
        at = np.where(np.isfinite(ahead), ahead, 0.0)
        x, y, s = self.x + at * self.dx, self.y + at * self.dy, self.s + at * self.ds
        r = np.sqrt(np.maximum(x * x + y * y, LEAST_R_MM**2))
        lead_in, tip, root = met == LEAD_IN, met == TIP, met == ROOT
        sign = np.where(met == UPPER, FLANK, np.where(met == LOWER, -FLANK, 0.0))
        radial, turn = np.where(tip, 0.0, 1.0), sign * self.lead / (r * r)
        out = radial / r
        gx, gy = out * x + turn * y, out * y - turn * x
        gs = sign + np.where(lead_in, self.fall, np.where(tip, 1.0, 0.0))
        slope = gx * self.dx + gy * self.dy + gs * self.ds
        slope = np.where(np.abs(slope) > 1e-3, slope, -1e-3)
        cosine = np.abs(slope) / np.sqrt(gx * gx + gy * gy + gs * gs)
        columns = np.empty((SIZE if rows else 0, len(x)))
        if rows:
            scale = 1.0 / slope
            gx, gy, gs = gx * scale, gy * scale, gs * scale
            columns[0], columns[1] = gx, gy
            columns[2], columns[3] = s * gx - x * gs, s * gy - y * gs
            columns[4] = sign * scale
            columns[5] = np.where(lead_in, self.fall * scale, 0.0)
            columns[OWN + RADIUS] = np.where(root | tip, 0.0, scale)
            columns[OWN + CREST_WIDTH] = np.abs(columns[4]) * np.sign(scale)
            columns[OWN + PITCH] = columns[4] * (self.lead / self.pitch * angle + ridge) if len(ridge) else 0.0
            columns[OWN + FALL] = np.where(lead_in, (self.lead_in - s) * scale, 0.0)
            columns[OWN + ROOT_RADIUS] = np.where(root, scale, 0.0)
            columns[OWN + SHARED] = np.where(np.isfinite(ahead), -ahead, 0.0)
        return Depths(ahead, met, columns, cosine, self.radius - r)
