"""What speaks against these being the recipe's studs: their length, their radius, one stud more on the circle. Pure."""

from __future__ import annotations

import numpy as np

from cellctl.vision.geometry import Array, carried
from cellctl.vision.part import Part, Refused
from cellctl.vision.pattern import nominal
from cellctl.vision.stud_points import Near
from cellctl.vision.stud_tips import HALF_LEVEL_MM, radius_of

LENGTH_SHARE, LENGTH_MM = 0.1, 1.0
RADIUS_SHARE, RADIUS_MM = 0.02, 0.15
"""By how much a stud may differ from the recipe. Crests of class 6g lie up to 0.16 mm of radius below nominal at M16
(ISO 965-1)."""
ENOUGH_OF_A_TIP = 0.5
LEAST_ON_SIDES, CREST_SHARE = 30, 0.05


def check_length(near: Near, part: Part, least_points: int) -> None:
    """Refuse (wrong_part) studs of another length than the recipe's."""
    if part.length_mm is None:
        return
    length = float(np.median(near.tips[near.counts >= least_points]))
    if abs(length - part.length_mm) > LENGTH_MM + LENGTH_SHARE * part.length_mm:
        raise Refused("wrong_part", f"the studs are {length:.1f} mm long; the recipe says {part.length_mm:g} mm")


def check_radius(radius_mm: float, part: Part) -> None:
    """Refuse (thread_wrong, or wrong_part for plain pins) studs of another radius than the recipe's."""
    expected = radius_of(part)
    if expected is None or abs(radius_mm - expected) <= RADIUS_MM + RADIUS_SHARE * expected:
        return
    code = "wrong_part" if part.thread is None else "thread_wrong"
    raise Refused(code, f"the studs have a radius of {radius_mm:.2f} mm; the recipe says {expected:.2f} mm")


def check_sides(near: Near, axes_mm: Array, part: Part) -> None:
    """Refuse (thread_wrong) studs whose sides do not stand at the drawn radius from their axes (n, 2) at the face.

    Seen from above a thread shows little but its crests: the middle of its points lies a twentieth of the pitch below
    them. No model takes part, which would fit another size somehow.
    """
    expected, pitch = radius_of(part), part.thread.pitch_mm if part.thread else 0.0
    if expected is None:
        return
    points, stud = near.rays.points, near.rays.stud
    middle = (points[2] > 0.15 * near.tips[stud]) & (points[2] < near.tips[stud] - 1.5 * max(pitch, 0.25 * expected))
    if np.count_nonzero(middle) < LEAST_ON_SIDES:
        return
    away = np.hypot(*(points[:2, middle] - axes_mm.T[:, stud[middle]])) - near.extra_mm[stud[middle]]
    radius = float(np.median(away)) + CREST_SHARE * pitch
    if abs(radius - expected) > 0.1 + 0.03 * expected + 0.1 * pitch:
        raise Refused(
            "thread_wrong", f"the studs have a radius of about {radius:.2f} mm; the recipe says {expected:.2f} mm"
        )


def check_count(local: Array, near: Near, part: Part) -> None:
    """Refuse (wrong_part) where the end of one stud more shows on the bolt circle: it would have no hole.

    `local` (3, N) are the points above the face in its frame.
    """
    level = float(np.median(near.tips))
    on = np.flatnonzero(np.abs(local[2] - level) < HALF_LEVEL_MM)
    (centre,) = carried(np.zeros((1, 2)), nominal(part), near.expected)
    u, v = local[:2, on] - centre[:, None]
    on_circle = np.abs(np.hypot(u, v) - 0.5 * part.circle_diameter_mm) < near.radius_mm
    there = np.sort(np.arctan2(*(near.expected - centre).T[::-1]))
    there = np.concatenate([there[-1:] - 2.0 * np.pi, there, there[:1] + 2.0 * np.pi])
    angle = np.sort(np.arctan2(v, u)[on_circle])
    after = np.searchsorted(there, angle)
    width = 2.0 * near.radius_mm / (0.5 * part.circle_diameter_mm)
    beside = np.minimum(angle - there[after - 1], there[after] - angle) > 0.75 * width
    rest = angle[beside]
    usual = np.count_nonzero(~beside) / max(int(np.count_nonzero(near.counts)), 1)
    crowd = np.searchsorted(rest, rest + width) - np.arange(len(rest))
    if len(rest) and crowd.max() > max(ENOUGH_OF_A_TIP * usual, 5.0):
        place = float(np.degrees(rest[int(np.argmax(crowd))] + 0.5 * width - there[1])) % 360.0
        raise Refused("wrong_part", f"one stud more than the recipe's stands on the circle, {place:.0f} degrees on")
