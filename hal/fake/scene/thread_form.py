"""The exact surface of a threaded stud with its lead-in, in the stud's own frame. Pure functions.

Stud frame: z along the axis from the face (0) to the tip (`length_mm`), phi = atan2(y, x). The solid is
r <= R(z, phi). Profile of ISO 68-1: 60 degree flanks, crest flat P/8; the root is cut at d3 (ISO 965-1), where a flat
of P/6 is left. The helix advances `starts * P` a turn; the lead-in is a cone down to the tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FLANK = float(np.sqrt(3.0))
"""dr/dz of a flank: 1 / tan(30 degrees)."""


@dataclass(frozen=True, slots=True)
class StudForm:
    """Sizes that all studs of a part share."""

    crest_radius_mm: float = 4.0
    pitch_mm: float = 1.0
    starts: int = 1
    hand: int = 1
    """+1 right, -1 left."""
    length_mm: float = 32.0
    lead_in_tan: float = 1.0
    """Tangent of the lead-in's half angle."""

    @property
    def root_radius_mm(self) -> float:
        """Half of d3 = d - 1.22687 P."""
        return self.crest_radius_mm - 0.613435 * self.pitch_mm

    @property
    def tip_radius_mm(self) -> float:
        """The flat end reaches down to the root."""
        return self.root_radius_mm


def _from_crest(form: StudForm, z: Array, phi: Array, phase: Array) -> Array:
    """Signed axial distance to the middle of the nearest crest, within +- P/2."""
    turns = (z - form.hand * form.starts * form.pitch_mm * phi / (2.0 * np.pi)) / form.pitch_mm - phase
    return np.asarray((turns - np.rint(turns)) * form.pitch_mm)


def surface_radius(form: StudForm, z: Array, phi: Array, phase: Array) -> Array:
    """R(z, phi) in mm; `phase` is the crest's place in turns of the pitch at phi = 0."""
    depth = (np.abs(_from_crest(form, z, phi, phase)) - form.pitch_mm / 16.0) * FLANK
    thread = form.crest_radius_mm - np.clip(depth, 0.0, form.crest_radius_mm - form.root_radius_mm)
    lead_in = form.tip_radius_mm + (form.length_mm - z) * form.lead_in_tan
    return np.asarray(np.minimum(thread, lead_in))


def height(form: StudForm, x: Array, y: Array, z: Array, phase: Array) -> Array:
    """r - R: positive outside. Along z it changes by at most FLANK per mm."""
    return np.hypot(x, y) - surface_radius(form, z, np.arctan2(y, x), phase)


def normals(form: StudForm, x: Array, y: Array, z: Array, phase: Array) -> Array:
    """(n, 3) unit normals out of the material at points on r = R: the gradient of r - R."""
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    off = _from_crest(form, z, phi, phase)
    depth = (np.abs(off) - form.pitch_mm / 16.0) * FLANK
    on_flank = (depth > 0.0) & (depth < form.crest_radius_mm - form.root_radius_mm)
    slope = np.where(on_flank, -FLANK * np.sign(off), 0.0)
    turn = -slope * form.hand * form.starts * form.pitch_mm / (2.0 * np.pi)
    thread = form.crest_radius_mm - np.clip(depth, 0.0, form.crest_radius_mm - form.root_radius_mm)
    on_lead_in = form.tip_radius_mm + (form.length_mm - z) * form.lead_in_tan < thread
    slope = np.where(on_lead_in, -form.lead_in_tan, slope)
    turn = np.where(on_lead_in, 0.0, turn) / r
    c, s = x / r, y / r
    gradient = np.stack([c + turn * s, s - turn * c, -slope], axis=-1)
    return np.asarray(gradient / np.linalg.norm(gradient, axis=-1, keepdims=True))


def first_hit(form: StudForm, origin: Array, ray: Array, start: Array, end: Array, phase: Array) -> Array:
    """Smallest t in [start, end] with r = R on `origin + t ray`, (n,); infinite where there is none.

    `origin`, `ray` (n, 3); no ray is inside before `start`, where it meets the crest cylinder or passes the tip. A ray
    that begins on a crest has hit it. The others march in steps of P/12 along z, less than a crest is wide; the sign
    change is then closed to rounding by the Illinois method.
    """
    found = np.full(start.shape, np.inf)
    step = form.pitch_mm / 12.0 / np.abs(ray[:, 2])
    active = np.flatnonzero(start <= end)
    t = start[active]
    f = _along(form, origin, ray, phase, active, t)
    on_crest = f <= 1e-9
    found[active[on_crest]] = t[on_crest]
    active, t, f = active[~on_crest], t[~on_crest], f[~on_crest]
    brackets: list[tuple[NDArray[np.intp], Array, Array, Array, Array]] = []
    while active.size:
        t_next = np.minimum(t + step[active], end[active])
        f_next = _along(form, origin, ray, phase, active, t_next)
        crossed = f_next <= 0.0
        brackets.append((active[crossed], t[crossed], t_next[crossed], f[crossed], f_next[crossed]))
        go_on = ~crossed & (t_next < end[active])
        active, t, f = active[go_on], t_next[go_on], f_next[go_on]
    if brackets:
        rows, a, b, fa, fb = (np.concatenate(column) for column in zip(*brackets, strict=True))
        found[rows] = _illinois(form, origin, ray, phase, rows, a, b, fa, fb)
    return found


def _along(form: StudForm, origin: Array, ray: Array, phase: Array, rows: NDArray[np.intp], t: Array) -> Array:
    p = origin[rows] + t[:, None] * ray[rows]
    return height(form, p[:, 0], p[:, 1], p[:, 2], phase[rows])


def _illinois(
    form: StudForm,
    origin: Array,
    ray: Array,
    phase: Array,
    rows: NDArray[np.intp],
    a: Array,
    b: Array,
    fa: Array,
    fb: Array,
) -> Array:
    """Root of the height inside brackets [a, b] with fa > 0 >= fb, to 1e-10 mm."""
    side = np.zeros(a.shape)
    t = b
    for _ in range(24):
        t = np.where(fa > fb, (a * fb - b * fa) / np.where(fa > fb, fb - fa, 1.0), b)
        f = _along(form, origin, ray, phase, rows, t)
        if float(np.max(np.abs(f), initial=0.0)) < 1e-10:
            break
        outside = f > 0.0
        fb = np.where(outside & (side == 1.0), 0.5 * fb, np.where(outside, fb, f))
        fa = np.where(~outside & (side == -1.0), 0.5 * fa, np.where(outside, f, fa))
        a, b = np.where(outside, t, a), np.where(outside, b, t)
        side = np.where(outside, 1.0, -1.0)
    return np.asarray(t)


def blocked(form: StudForm, point: Array, towards: Array, phase: Array) -> NDArray[np.bool_]:
    """Whether the stud itself hides its surface points (n, 3) from places in directions `towards` (n, 3), per z of 1.

    Marches up in steps of P/24 until the ray has left the crest cylinder or passed the tip.
    """
    hidden = np.zeros(point.shape[0], dtype=np.bool_)
    active = np.arange(point.shape[0])
    step = form.pitch_mm / 24.0
    travelled = 0.02
    while active.size:
        p = point[active] + travelled * towards[active]
        inside = height(form, p[:, 0], p[:, 1], p[:, 2], phase[active]) < -1e-3
        hidden[active[inside]] = True
        free = (np.hypot(p[:, 0], p[:, 1]) > form.crest_radius_mm) | (p[:, 2] > form.length_mm)
        active = active[~inside & ~free]
        travelled += step
    return hidden
