"""Whether a covariance is true: errors of a fit under known noise, against what its covariance says of them."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from cellctl.vision import fit
from cellctl.vision.fit import Element
from cellctl.vision.fit.result import frame_of
from tests.vision.fit import minima, sets
from tests.vision.fit.reference import Array

NOISE = 1e-8
"""Of the extent of the points: far above the rounding, and small enough for errors to follow it in proportion."""
FAR = 10.0
"""How far out on an axis its position is checked, in lengths of the part that the points cover."""


def ratios(kind: str, rng: np.random.Generator) -> dict[str, float]:
    """For a perfect set with noise along all axes: variance told over variance given, squared normalised error per
    parameter, and that of the position far out on the axis. All have mean one. Nothing where the points lie on several
    such elements (two rings of four lie on three cylinders) and the noise chose another one."""
    points = sets.draw(kind, rng, exact=True).points
    truth = getattr(fit, kind)(points)
    sigma = NOISE * float(np.ptp(points, axis=0).max())
    points = points + sigma * rng.standard_normal(points.shape)
    found = getattr(fit, kind)(points)
    if truth.direction is not None and abs(truth.direction @ found.direction) < 0.99:
        return {}
    size = minima.SHAPES[kind]
    degrees = len(points) * (2 if kind in ("line", "circle") else 1) - size
    variance = minima.sum_of_squares(kind, points, minima.guess_of(found)) / degrees
    covariance = found.covariance * sigma**2 / variance  # as if the noise were known: few points tell little of it
    error = difference(found, truth)
    free = coordinates(truth)
    result = {"variance": variance / sigma**2, "parameters": normalised(free, error, covariance) / size}
    if kind in ("line", "cylinder", "cone"):
        out = np.zeros((2, len(error)))
        out[:, :3], out[:, 3:6] = free[:2, :3], FAR * float(np.ptp(points @ found.direction)) * free[:2, :3]
        result["far out on the axis"] = normalised(out, error, covariance) / 2.0
    return result


def coordinates(truth: Element) -> Array:
    """Rows that take the numbers of a covariance to as many as are free."""
    if truth.direction is None:
        return np.eye(4)
    frame = frame_of(truth.direction)
    places = {"plane": frame[2:], "circle": frame}.get(truth.kind, frame[:2])
    sizes = (truth.radius_mm is not None) + (truth.apex_angle_deg is not None)
    blocks = [places, frame[:2], *[np.eye(1)] * sizes]
    return np.asarray(block_diag(*blocks))


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


def normalised(rows: Array, error: Array, covariance: Array) -> float:
    """Squared length of some combinations of an error in units of their covariance."""
    values, told = rows @ error, rows @ covariance @ rows.T
    scale = np.sqrt(np.diag(told))
    return float((values / scale) @ np.linalg.solve(told / np.outer(scale, scale), values / scale))
