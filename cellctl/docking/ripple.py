"""Long-wave ripple of the scanner's depth as a type B cause: waves that no residual shows. Pure.

The certificate says how strong the ripple is, not where its crests lie: phase and direction are open, the wavelength
is anything from what a scan's own residuals would show to the whole field of view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import j0

from cellctl.calibration import Calibration
from cellctl.docking.joint import Joint
from cellctl.kinematics import Array
from cellctl.vision.part import PartMeasurement

SHORTEST_MM, LONGEST_MM = 40.0, 320.0
WAVES = np.geomspace(SHORTEST_MM, LONGEST_MM, 13)
"""Wavelengths, all powers of two alike likely (log-uniform)."""
LEAST_SHARE = 1e-3
"""Patterns of ripple that carry less than this share of the variance are left out."""


def correlation(distance_mm: Array) -> Array:
    """Of the ripple at two places so far apart: mean of J0(2 pi d / wavelength), every direction alike likely."""
    return np.asarray(j0(2.0 * np.pi * distance_mm[..., None] / WAVES).mean(axis=-1))


def slope_per_mm() -> float:
    """Rms slope of the ripple along each of two directions, for a ripple of one sigma = 1 mm."""
    return float(2.0 * np.pi * np.sqrt(0.5 * np.mean(WAVES**-2.0)))


@dataclass(frozen=True, slots=True)
class RippleNoise:
    """What ripple does to the centres of n features, variance per axis: `own_mm2` (n,) for itself, by the slope of the
    waves over its width; `waves_mm2` (n,) with its neighbours, by the depth of the waves along a slanting ray."""

    own_mm2: Array
    waves_mm2: Array


def ripple_noise(part: PartMeasurement, calibration: Calibration, view: Literal["rotor", "shaft"]) -> RippleNoise:
    """For a part measured in the cell frame in that view."""
    variance = calibration.scanner.sigma_ripple_mm**2
    rays = _rays(np.array([feature.center_mm for feature in part.features]), calibration.views[view].matrix[:3, 3])
    radius = np.array([feature.radius_mm or 0.0 for feature in part.features])
    slant = 1.0 - (rays @ part.face.normal) ** 2
    return RippleNoise(variance * (slope_per_mm() * radius) ** 2, 0.5 * variance * slant)


def ripple_causes(
    joint: Joint,
    calibration: Calibration,
    table: Array,
    shares: tuple[Array, Array],
    offsets_of: Callable[[Joint], tuple[Array, Array]],
) -> Array:
    """(n, 2, k) change of each bolt's offset by k independent patterns of ripple, both views together.

    A depth error moves a feature along its ray, and so sideways by the ray's slant. The pattern follows as a whole;
    of what is left of a bolt's own shift it follows by the share (n,) that is kept of its hole's, its stud's residual
    (`shares`). `table` (4, 4) is the pose at which the shaft was seen, `offsets_of` gives the offsets (n, 2) at the
    target and their jacobian (n, 2, 3).
    """
    sigma = calibration.scanner.sigma_ripple_mm
    if sigma == 0.0:
        return np.zeros((len(joint.holes), 2, 0))
    exact, jacobian = offsets_of(joint)
    holes = joint.holes @ table[:3, :3].T + table[:3, 3]
    hole_rays = _rays(holes, calibration.views["shaft"].matrix[:3, 3])
    stud_rays = _rays(joint.studs, calibration.views["rotor"].matrix[:3, 3])
    moved_holes = replace(joint, holes=joint.holes + sigma * hole_rays @ table[:3, :3])
    moved_studs = replace(joint, studs=joint.studs + sigma * stud_rays)
    columns = []
    for places, moved, share in zip((holes, joint.studs), (moved_holes, moved_studs), shares, strict=True):
        shifts = _patterns(places)[:, None, :] * (offsets_of(moved)[0] - exact)[:, :, None]
        whole = np.einsum("iak,kc->iac", jacobian, rigid_motion(shifts, jacobian))
        columns.append(whole + share[:, None, None] * (shifts - whole))
    return np.concatenate(columns, axis=2)


def rigid_motion(effects: Array, jacobian: Array) -> Array:
    """(3, k) rigid motions (x mm, y mm, turn rad) that come nearest to the changes of the offsets (n, 2, k)."""
    normal = np.einsum("iak,ial->kl", jacobian, jacobian)
    return np.asarray(np.linalg.solve(normal, np.einsum("iak,iac->kc", jacobian, effects)))


def _rays(places: Array, scanner: Array) -> Array:
    away = places - scanner
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def _patterns(places: Array) -> Array:
    """(n, k) independent patterns of unit-variance ripple at places (n, 3)."""
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    values, vectors = np.linalg.eigh(correlation(distance))
    kept = values > LEAST_SHARE * len(places)
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))
