"""Whether a covariance is true: errors of a fit under known noise, against what its covariance says of them."""

from __future__ import annotations

import numpy as np

from cellctl.vision import fit
from cellctl.vision.fit import Element
from tests.vision.fit import minima, sets
from tests.vision.fit.reference import Array

NOISE = 1e-8
"""Of the extent of the points: far above the rounding, and small enough for errors to follow it in proportion."""
FAR = 10.0
"""How far out on an axis its position is checked, in lengths of the part that the points cover."""


def ratios(kind: str, rng: np.random.Generator) -> dict[str, float]:
    """For a perfect set with noise along all axes: variance told over variance given, squared normalised error per
    parameter, and that of the position far out on the axis. All have mean one."""
    points = sets.draw(kind, rng, exact=True).points
    truth = getattr(fit, kind)(points)
    sigma = NOISE * float(np.ptp(points, axis=0).max())
    points = points + sigma * rng.standard_normal(points.shape)
    found = getattr(fit, kind)(points)
    size = minima.SHAPES[kind]
    degrees = len(points) * (2 if kind in ("line", "circle") else 1) - size
    variance = minima.sum_of_squares(kind, points, minima.guess_of(found)) / degrees
    covariance = found.covariance * sigma**2 / variance  # as if the noise were known: few points tell little of it
    error = difference(found, truth)
    result = {"variance": variance / sigma**2, "parameters": normalised(error, covariance) / size}
    if kind in ("line", "cylinder", "cone"):
        along = FAR * float(np.ptp(points @ found.direction))
        out = np.hstack([np.eye(3), along * np.eye(3), np.zeros((3, len(error) - 6))])
        result["far out on the axis"] = normalised(out @ error, out @ covariance @ out.T) / 2.0
    return result


def difference(found: Element, truth: Element) -> Array:
    """Error of the numbers that a covariance is of, at the same place along the axis or in the plane."""
    offset = found.point_mm - truth.point_mm
    if truth.direction is None or found.direction is None:
        return np.append(offset, (found.radius_mm or 0.0) - (truth.radius_mm or 0.0))
    direction = truth.direction * np.sign(truth.direction @ found.direction)
    along = float(offset @ direction)
    if truth.kind == "plane":
        offset = along * direction
    elif truth.kind != "circle":
        offset = offset - along * direction
    result = [*offset, *(found.direction - direction)]
    if found.radius_mm is not None and truth.radius_mm is not None:
        widening = along * np.tan(np.radians(truth.apex_angle_deg or 0.0) / 2.0)
        result.append(found.radius_mm - truth.radius_mm - widening)
    if found.apex_angle_deg is not None and truth.apex_angle_deg is not None:
        result.append(found.apex_angle_deg - truth.apex_angle_deg)
    return np.array(result)


def normalised(error: Array, covariance: Array) -> float:
    """Squared length of an error in units of its covariance, which may be singular."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 1e-9 * scale.max(), scale, scale.max())
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    inside = vectors.T @ (error / scale)
    real = values > 1e-9 * values[-1]
    return float((inside[real] ** 2 / values[real]).sum())
