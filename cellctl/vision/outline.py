"""Circles through the outlines of holes in the face: where neither wall nor chamfer was seen, or none is drawn.

A camera blurs, lifts and loses what lies at an edge, and does so alike at every hole: the outlines are fitted together,
each with its own centre, with one radius for holes that are drawn alike, and with one profile over the direction that
all of them share. What is missing at one hole is then known from the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import Array
from cellctl.vision.part import Part
from cellctl.vision.pattern import fit_pattern, placed

ROUNDS = 13
PROFILED, PLACED = 4, 5  # the first round with a profile, and the one that starts from the pattern's places
WINDOW = 3  # sectors in which the innermost point is looked for: they overlap, so that their place does not matter
WIDTH = 1.8  # of that window, in spacings
REACH = 3.2  # how far outside the outline an edge point may lie, in spacings
INNER, OUTER = 0.7, 1.5  # the same as a share of the radius, to either side
BAND, MOST_BAND_MM = 2.5, 1.0  # height of what still belongs to the face at an edge, in spacings and at most
TUKEY = 3.5
LEAST_SCATTER = 0.1  # of the spacing
USUAL_SCATTER = 1.2  # a torn outline scatters widely: it is cut near where the others are, not to keep its wrong edges
LOOKS_ALIKE = 0.15  # difference of a radius from the usual one, as a share, up to which holes may share it
LEAST_SEEN = 0.2  # of an outline that has a say in where the pattern is
PLACE_SIGMA_MM = 0.05  # added where the pattern gives the start: an edge in the wrong place looks as sure as any
INFLATION = 2.5  # of variances: an artefact at the edge is wider than a sector. From emulated scans with known centres


@dataclass(frozen=True, slots=True)
class Outline:
    """Circle (centre (2,), radius) in the face, `covariance` (2, 2) of the centre, and how the outline looks.

    `arc` is the share of the outline that was seen, `fill` the share of the disk that is covered by face points,
    `points` how many of them lie along the outline.
    """

    centre_mm: Array
    radius_mm: float
    covariance: Array
    scatter_mm: float
    arc: float
    fill: float
    points: int


@dataclass(frozen=True, slots=True)
class _Step:
    """Change of centres (n, 2) and radii (n,), covariance (n, 2, 2) of the centres, scatter (n,), edges used (n, S)."""

    centre: Array
    radius: Array
    covariance: Array
    scatter: Array
    used: NDArray[np.bool_]


def edge_band_mm(sigma_mm: float, spacing_mm: float) -> float:
    """Height above or below the face up to which points at an edge are taken for the face's own.

    A camera blurs and lifts the surface there: without a chamfer to confuse it with, all of that is face.
    """
    return max(4.0 * sigma_mm, min(BAND * spacing_mm, MOST_BAND_MM))


def fit_outlines(
    uv: Array, owner: NDArray[np.intp], centres_mm: Array, radii_mm: Array, spacing_mm: float, part: Part | None = None
) -> list[Outline]:
    """Outlines of holes at about `centres_mm` (n, 2) with `radii_mm` (n,) from face points (M, 2); `arc` may be 0.

    `owner` (M,) is the hole that each point lies around. With `part`, in whose frame all lies, holes that are drawn
    alike share their radius, and where the pattern has them tells what edge is theirs. Limited by the sampling: an edge
    lies anywhere within one spacing of the innermost point, and the radius is corrected by half a spacing.
    """
    centre, group = centres_mm, np.arange(len(centres_mm)) if part is None else _drawn(part)
    radius = start = _shared(radii_mm, group)
    sectors = WINDOW * int(np.clip(2.0 * np.pi * float(np.median(radius)) / (WIDTH * spacing_mm), 12, 180))
    angle = (np.arange(sectors) + 0.5) * 2.0 * np.pi / sectors
    ways = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile = np.zeros(sectors)
    edge = _edges(uv - centre[owner], owner, radius, sectors, spacing_mm)
    step = _step(edge, ways, group, start - radius, spacing_mm, np.inf)
    for turn in range(1, ROUNDS):
        centre, radius = centre + step.centre, radius + step.radius
        if turn == PLACED and part is not None:
            centre = _placed(part, centre, step)
        edge = _edges(uv - centre[owner], owner, radius, sectors, spacing_mm)
        if turn >= PROFILED:
            profile = _profile(edge, ways)
        if turn == PLACED and part is not None:  # about the places, where no wrong radius has moved a centre aside
            group, start = _regrouped(group, radius, edge - profile, float(np.median(step.scatter)))
            edge, radius = edge + (radius - start)[:, None], start
        usual = USUAL_SCATTER if turn >= PROFILED else np.inf
        step = _step(edge - profile, ways, group, start - radius, spacing_mm, usual)
    centre, radius = centre + step.centre, radius + step.radius
    return _seen(uv - centre[owner], owner, centre, radius, step, spacing_mm)


def _seen(
    offset: Array, owner: NDArray[np.intp], centre: Array, radius: Array, step: _Step, spacing_mm: float
) -> list[Outline]:
    """The outlines where they ended."""
    count, distance = len(centre), np.hypot(*offset.T)
    along = np.bincount(owner[np.abs(distance - radius[owner]) < spacing_mm], minlength=count)
    inside = np.bincount(owner[distance < 0.8 * radius[owner]], minlength=count)
    whole = np.maximum(np.pi * (0.8 * radius) ** 2 / spacing_mm**2, 1.0)
    return [
        Outline(
            centre_mm=centre[k],
            radius_mm=float(radius[k] - 0.5 * spacing_mm),
            covariance=step.covariance[k],
            scatter_mm=float(step.scatter[k]),
            arc=float(step.used[k].mean()),
            fill=float(inside[k] / whole[k]),
            points=int(along[k]),
        )
        for k in range(count)
    ]


def _drawn(part: Part) -> NDArray[np.intp]:
    """Group (n,) of each hole: those of one size on the drawing, all where it gives none."""
    drawn = np.zeros(part.count) if part.diameter_mm is None else np.asarray(part.diameter_mm)
    return np.unique(drawn, return_inverse=True)[1].astype(np.intp)


def _shared(radii_mm: Array, group: NDArray[np.intp]) -> Array:
    """The median radius of its group for each hole (n,)."""
    return np.array([float(np.median(radii_mm[group == own])) for own in group])


def _regrouped(
    group: NDArray[np.intp], radius: Array, edge: Array, scatter_mm: float
) -> tuple[NDArray[np.intp], Array]:
    """Groups (n,) and radii (n,) where a hole that plainly has another radius than its group is alone with its own.

    Plainly: many of its edges lie on that other circle, and by far more than on its group's.
    """
    shift = _medians(edge)
    own, shared = (np.count_nonzero(np.abs(edge - of) < scatter_mm, axis=1) for of in (shift[:, None], 0.0))
    other = (np.abs(shift) > LOOKS_ALIKE * radius) & (own > 0.4 * edge.shape[1]) & (own > 3 * shared)
    alone = np.arange(len(group)) + len(group)
    return np.where(other, alone, group).astype(np.intp), np.where(other, radius + shift, radius)


def _medians(rows: Array) -> Array:
    """Median (n,) of the finite values in each row (n, S), the lower one of two; 0 where there is none."""
    count = np.isfinite(rows).sum(axis=1)
    ordered = np.sort(rows, axis=1)  # NaN come last
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    return np.where(count > 0, middle, 0.0)


def _edges(offset: Array, owner: NDArray[np.intp], radius: Array, sectors: int, spacing_mm: float) -> Array:
    """How far (n, S) outside the circle the innermost point near it lies, NaN where a sector shows none."""
    count = len(radius)
    distance = np.hypot(*offset.T)
    outer = np.minimum(radius + REACH * spacing_mm, OUTER * radius)
    near = np.flatnonzero((distance > INNER * radius[owner]) & (distance < outer[owner]))
    turn = np.arctan2(offset[near, 1], offset[near, 0]) / (2.0 * np.pi) % 1.0
    sector = np.minimum((turn * sectors).astype(np.intp), sectors - 1)
    first = np.full(count * sectors, np.inf)
    np.minimum.at(first, owner[near] * sectors + sector, distance[near])
    table = first.reshape(count, sectors)
    half = WINDOW // 2
    inner = np.min([np.roll(table, shift, axis=1) for shift in range(-half, half + 1)], axis=0)
    return np.where(np.isfinite(inner), inner - radius[:, None], np.nan)


def _profile(edge: Array, ways: Array) -> Array:
    """What outlines (n, S) have in common (S,) beyond a circle; mean and first harmonic belong to radius and centre."""
    seen = np.isfinite(edge).sum(axis=0) >= 3
    common = np.zeros(edge.shape[1])
    common[seen] = np.nanmedian(edge[:, seen], axis=0)
    common = np.mean([np.roll(common, shift) for shift in range(1 - WINDOW, WINDOW)], axis=0)
    common -= common.mean()
    return np.asarray(common - ways @ (common @ ways) * 2.0 / len(common))


def _step(edge: Array, ways: Array, group: NDArray[np.intp], pull_mm: Array, spacing_mm: float, usual: float) -> _Step:
    """One Gauss-Newton step with Tukey weights; a group's radius is eliminated from the centres (Schur complement).

    Where a group shows too little of its outlines, its radius is held to the start, `pull_mm` (n,) away. Edges are cut
    at the scatter of their own outline, or at `usual` times the median one where that is less.
    """
    seen = np.isfinite(edge)
    value = np.where(seen, edge, 0.0)
    scatter = np.maximum(1.4826 * _medians(np.abs(edge)), LEAST_SCATTER * spacing_mm)
    ratio = value / (TUKEY * np.minimum(scatter, usual * float(np.median(scatter)))[:, None])
    used = seen & (np.abs(ratio) < 1.0)
    weight = np.where(used, (1.0 - ratio**2) ** 2, 0.0) / (WINDOW * INFLATION * scatter[:, None] ** 2)
    square = np.einsum("ns,si,sj->nij", weight, ways, ways) + 1e-6 * np.eye(2)
    cross, pull = weight @ ways, (weight * value) @ ways
    inverse = np.linalg.inv(square)
    carried = np.einsum("nij,nj->ni", inverse, cross)
    own = weight.sum(axis=1) - (carried * cross).sum(axis=1)
    wanted = (weight * value).sum(axis=1) - (carried * pull).sum(axis=1)
    held = spacing_mm**-2
    known = np.bincount(group, own)[group] + held
    radius = (np.bincount(group, wanted)[group] + held * pull_mm) / known
    centre = np.einsum("nij,nj->ni", inverse, pull - cross * radius[:, None])
    limit = 2.0 * spacing_mm
    return _Step(
        centre=np.clip(centre, -limit, limit),
        radius=radius,
        covariance=inverse + carried[:, :, None] * carried[:, None, :] / known[:, None, None],
        scatter=scatter,
        used=used,
    )


def _placed(part: Part, centre: Array, step: _Step) -> Array:
    """Where the pattern, fitted to all centres (n, 2), has its holes: a start that one torn outline does not spoil."""
    enough = step.used.mean(axis=1) >= LEAST_SEEN
    if np.count_nonzero(enough) < 3:
        return centre
    places = np.where(enough[:, None], centre, np.nan)
    fitted = fit_pattern(part, places, step.covariance + PLACE_SIGMA_MM**2 * np.eye(2), 0.0)
    return placed(part, fitted)
