"""Minimum zones: flatness, roundness, cylindricity as the narrowest band that holds all points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.fit import models, starts
from cellctl.vision.fit.elements import CYLINDER
from cellctl.vision.fit.minimax import narrowest
from cellctl.vision.fit.result import Element, checked, frame_of, principal, signed
from cellctl.vision.fit.search import Shape
from cellctl.vision.fit.slab import thinnest

Points = NDArray[np.floating]
RING = Shape("circle in a plane", models.sphere, starts.spheres)


def plane_zone(points_mm: Points) -> Element:
    """Flatness: two parallel planes as close as can be (at least 3 points). `point_mm` lies midway."""
    points = checked(points_mm, 3)
    centre, _, rows = principal(points)
    normal = signed(thinnest((points - centre) @ rows.T)[0] @ rows)
    height = (points - centre) @ normal
    middle = 0.5 * float(height.max() + height.min())
    return Element("plane_zone", centre + middle * normal, height - middle, float(np.ptp(height)), normal,
                   stopped="every pair of support planes")  # fmt: skip


def circle_zone(points_mm: Points) -> Element:
    """Roundness: two concentric circles as close as can be, in the least-squares plane of the points (at least 3)."""
    points = checked(points_mm, 3)
    centre, spread, rows = principal(points)
    frame, scale = frame_of(signed(rows[0])), float(np.linalg.norm(spread))
    local = (points - centre) @ frame[:2].T / scale
    flat = thinnest((points - centre) @ rows[1:].T / scale)[1]
    band = narrowest(RING, local, flat)
    x = scale * band.parameters
    return Element("circle_zone", centre + x[:2] @ frame[:2], scale * band.residuals, scale * band.width, frame[2],
                   float(x[2]), iterations=band.rounds, stopped=band.stopped)  # fmt: skip


def cylinder_zone(points_mm: Points) -> Element:
    """Cylindricity: two coaxial cylinders as close as can be (at least 5 points)."""
    points = checked(points_mm, 5)
    centre, spread, rows = principal(points)
    scale = float(np.linalg.norm(spread))
    local = (points - centre) / scale
    band = narrowest(CYLINDER, local, thinnest(local @ rows.T)[1])
    x = band.parameters
    axis = np.append(x[2:4], 1.0) / np.sqrt(1.0 + x[2] ** 2 + x[3] ** 2)
    foot = np.append(x[:2], 0.0)
    foot = foot - (foot @ axis) * axis  # that of the centroid, the origin
    return Element("cylinder_zone", centre + scale * foot @ band.frame, scale * band.residuals, scale * band.width,
                   signed(axis @ band.frame), scale * float(x[4]), iterations=band.rounds,
                   stopped=band.stopped)  # fmt: skip
