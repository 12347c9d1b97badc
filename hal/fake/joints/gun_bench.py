"""Where the guns stand and what their sockets touch. Pure.

Gun a stands at the angle of the gun table on the bolt circle, gun b opposite. Both ride on one feed, upwards: with the
feed at 0 a socket's mouth is at `mouth_mm` in the cell. On the default joint (rotor's face at 400 mm, studs 32 mm,
flange 14 mm) an inner socket with a fresh nut meets the stud's end at feed 89.6, an empty socket rests on the edge of
a seated nut at 100, has dropped over its hex at 106, and meets the bare flange at 109.6.

A socket telescopes: an air slide yields first, with a small constant force over `slide_mm`, then a spring, then metal.
It stays on a nut that climbs away from it as far as the slide reaches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CONTACT_N = 0.5
"""A socket that feels less than this touches nothing."""


@dataclass(frozen=True, slots=True)
class GunBench:
    """Drawing of the gun carriage and its sockets."""

    mouth_mm: float = 276.4
    slide_mm: float = 25.0
    slide_n: float = 2.0
    spring_n_per_mm: float = 5.0
    spring_mm: float = 12.0
    stiff_n_per_mm: float = 2000.0
    hex_depth_mm: float = 6.0
    """How far the socket drops over a nut's hex."""
    hex_play_deg: float = 2.5
    hex_pitch_deg: float = 60.0
    off_axis_mm: float = 1.0
    """A gun further off the stud's axis than this cannot engage."""
    start_n: float = 4.0
    """Axial force that a nut needs to take the thread."""
    rubbing_nm: float = 0.2
    crush_n: float = 500.0
    """Contact force that ruins nut and thread."""


def force_n(bench: GunBench, feed_mm: Array, contact_mm: float) -> Array:
    """Contact force (n,) at `feed_mm` (n,) where the slide is fully in at `contact_mm`."""
    into = np.asarray(feed_mm, dtype=np.float64) - contact_mm
    spring = bench.spring_n_per_mm * np.clip(into, 0.0, bench.spring_mm)
    stiff = bench.stiff_n_per_mm * np.maximum(into - bench.spring_mm, 0.0)
    return np.asarray(np.where(into >= -bench.slide_mm, bench.slide_n + spring + stiff, 0.0))


def facing(bench: GunBench, stud_mm: Array, circle_radius_mm: float, gun_deg: float) -> int | None:
    """The stud (n, 2) whose end the gun at `gun_deg` stands under, or None when it is too far off every axis."""
    angle = math.radians(gun_deg)
    here = circle_radius_mm * np.array([math.cos(angle), math.sin(angle)])
    distance = np.hypot(*(stud_mm - here).T)
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] <= bench.off_axis_mm else None


def misfit_deg(bench: GunBench, nut_deg: float, socket_deg: float) -> float:
    """How far the socket must turn forward (positive sense of the cell) to fit the hex, in [0, pitch)."""
    return (nut_deg - socket_deg) % bench.hex_pitch_deg


def fits(bench: GunBench, nut_deg: float, socket_deg: float) -> bool:
    """Whether the socket drops over the hex as it stands."""
    misfit = misfit_deg(bench, nut_deg, socket_deg)
    return min(misfit, bench.hex_pitch_deg - misfit) <= bench.hex_play_deg
