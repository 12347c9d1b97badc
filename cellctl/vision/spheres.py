"""The sphere artefact: measured centres against certified ones. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellctl.vision.geometry import Array, Points, inverse, transform
from cellctl.vision.part import Refused

MIN_POINTS = 60
"""A cap of fewer points does not fix a sphere."""


@dataclass(frozen=True, slots=True)
class SphereFit:
    """Centre (3,) of a sphere, scanner frame; its covariance (3, 3) is `sigma_mm` squared times `cofactor`.

    `sigma_mm` is the robust scale of the residuals across the surface. The cofactor takes points for independent.
    """

    center_mm: Array
    cofactor: Array
    sigma_mm: float


def sphere_fits(
    points: Points,
    T_cell_scanner: Array,
    expected_centres_cell_mm: Array,
    diameter_mm: float,
    *,
    search_mm: float = 8.0,
) -> tuple[SphereFit, ...]:
    """Every sphere of the artefact, in the scanner frame. As `artefact_residuals` in all else."""
    flat = points.reshape(-1, 3)
    expected = transform(inverse(T_cell_scanner), np.asarray(expected_centres_cell_mm, dtype=np.float64))
    radius = 0.5 * diameter_mm
    fits = []
    for i, place in enumerate(expected):
        found = fit_sphere(_around(flat, place, radius + search_mm), place, radius, search_mm)
        if found is None:
            raise Refused("artefact_moved", f"sphere {i} of the artefact is not within {search_mm:g} mm of its place")
        fits.append(found)
    return tuple(fits)


def artefact_residuals(
    points: Points,
    T_cell_scanner: Array,
    expected_centres_cell_mm: Array,
    diameter_mm: float,
    *,
    search_mm: float = 8.0,
) -> Array:
    """Measured minus certified sphere centres (n, 3) in the cell frame, mm.

    `points` (..., 3) in the scanner frame, pinhole at its origin; `expected_centres_cell_mm` (n, 3). A sphere is
    searched within `search_mm` of its place. Raises Refused artefact_moved where one is not found there; how large a
    residual may be is the caller's gate.
    """
    fits = sphere_fits(points, T_cell_scanner, expected_centres_cell_mm, diameter_mm, search_mm=search_mm)
    seen = transform(T_cell_scanner, np.array([fit.center_mm for fit in fits]))
    return np.asarray(seen - np.asarray(expected_centres_cell_mm, dtype=np.float64))


def fit_sphere(points: Array, start: Array, radius_mm: float, search_mm: float) -> SphereFit | None:
    """A sphere of certified radius near `start`, or None. Rays come from the origin.

    Robust least squares of the depth along each ray; the noise there grows with one over the cosine of incidence.
    Started from the best of a coarse search, because posts and stems stand beside the sphere.
    """
    if len(points) < MIN_POINTS:
        return None
    some = points[:: max(1, len(points) // 600)]
    centre = _coarse(some, start, radius_mm, search_mm)
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = np.einsum("ij,ij->i", points, directions)
    scale = 1.0
    for turn in range(25):
        miss, slope, cosine = _depth(directions, along, centre, radius_mm)
        ratio = np.abs(miss) * cosine / scale
        weights = np.where(ratio < 4.7, (1.0 - np.minimum(ratio / 4.7, 1.0) ** 2) ** 2, 0.0) * cosine**2
        used = weights > 0
        if np.count_nonzero(used) < MIN_POINTS:
            return None
        normal = np.einsum("ni,n,nj->ij", slope, weights, slope)
        step = -np.linalg.solve(
            normal + 1e-9 * np.eye(3), np.einsum("ni,n,n->i", slope, weights, np.where(used, miss, 0.0))
        )
        centre = centre + step
        spread = 1.4826 * float(np.median((np.abs(miss) * cosine)[used]))
        scale = max(0.5 * scale, spread, 1e-6) if turn < 8 else max(spread, 1e-6)
        if turn > 8 and np.linalg.norm(step) < 1e-7:
            break
    share = int(np.count_nonzero(used)) / max(int(np.count_nonzero(cosine > 0.35)), 1)
    if np.linalg.norm(centre - start) > search_mm or scale > 0.02 * radius_mm or share < 0.5:
        return None
    return SphereFit(np.asarray(centre), np.linalg.inv(normal), scale)


def _around(flat: Points, place: Array, reach: float) -> Array:
    """Points within `reach` of a place: first a box, which is cheap on the whole cloud."""
    with np.errstate(invalid="ignore"):
        box = np.flatnonzero(np.abs(flat[:, 0] - place[0]) < reach)
        box = box[np.abs(flat[box, 1] - place[1]) < reach]
        box = box[np.abs(flat[box, 2] - place[2]) < reach]
    near = flat[box].astype(np.float64)
    return np.asarray(near[np.sum((near - place) ** 2, axis=1) < reach**2])


def _coarse(points: Array, start: Array, radius: float, search: float) -> Array:
    """Candidate centre on a grid around `start` that most points lie on within a twentieth of the radius."""
    step = 0.1 * radius
    line = np.arange(-np.ceil(search / step), np.ceil(search / step) + 1) * step
    offsets = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = offsets[np.sum(offsets**2, axis=1) <= search**2]
    votes = np.empty(len(offsets))
    for at in range(0, len(offsets), 256):
        centres = start + offsets[at : at + 256]
        square = np.sum(points**2, axis=1)[None] - 2.0 * centres @ points.T + np.sum(centres**2, axis=1)[:, None]
        gap = np.sqrt(np.maximum(square, 0.0)) - radius
        votes[at : at + 256] = np.sum(np.maximum(0.0, 1.0 - (gap / (0.08 * radius)) ** 2), axis=1)
    return np.asarray(start + offsets[int(votes.argmax())])


def _depth(directions: Array, along: Array, centre: Array, radius: float) -> tuple[Array, Array, Array]:
    """Predicted minus measured depth (n,), its derivative (n, 3) by the centre, cosine of incidence (n,).

    Rays that pass beside, or meet the sphere steeper than 70 degrees, get an infinite miss.
    """
    middle = directions @ centre
    square = radius**2 - (centre @ centre - middle**2)
    half = np.sqrt(np.maximum(square, 1e-12))
    cosine = half / radius
    good = (square > 0) & (cosine > 0.342)
    normal = ((middle - half)[:, None] * directions - centre) / radius
    slope = -normal / np.maximum(cosine, 0.342)[:, None]
    return np.where(good, middle - half - along, np.inf), slope, np.where(good, cosine, 1e-3)
