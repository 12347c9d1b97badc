"""How much the face looks as if the pattern's holes were where a pose says: what tells rival poses apart.

A void of about the right size is found in many a patch of missing points. A hole's outline is round, all around, and in
its place; and where points of the face cover its place, there is none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cellctl.vision.geometry import Array
from cellctl.vision.outline import LEAST_SEEN, PLACE_SIGMA_MM, Outline, fit_outlines
from cellctl.vision.part import Part
from cellctl.vision.pattern import PatternPose, fit_pattern, placed

ROUND = 0.6  # scatter of an outline, in spacings, that halves the likeness
PLACED = 1.0  # distance from the place, in spacings, that does
ASIDE = 0.25  # share of the disk about the place that a hole a little aside leaves covered
WHOLE = 0.5  # arc of outlines that say where the pattern is, where there are three of them
CLOSED = 0.25  # share of the disk that points cover where there is no hole


def by_likeness(
    poses: list[PatternPose], uv: Array, part: Part, radii_mm: Array, spacing_mm: float
) -> list[PatternPose]:
    """The poses with the likeness of their holes as score, best first, each moved to where the outlines have it.

    Each hole counts 1 for a perfect outline at its place, 0 for none seen, -1 for a closed face. `uv` (N, 2) are the
    face's points with its edges, `radii_mm` (P, n) about the holes' radii in each pose. A place that several poses have
    is looked at once, so that only what they have not in common makes the difference.
    """
    expected = [placed(part, pose) for pose in poses]
    place, which = _distinct(np.concatenate(expected), 0.5 * float(np.min(radii_mm)))
    sizes = np.array([float(np.median(radii_mm.reshape(-1)[which == k])) for k in range(len(place))])
    found = cKDTree(place).query(uv, distance_upper_bound=1.6 * float(np.max(sizes)))
    near = np.flatnonzero(np.isfinite(found[0]))
    distance, owner = np.asarray(found[0])[near], np.asarray(found[1])[near].astype(np.intp)
    outlines = fit_outlines(uv[near], owner, place, sizes, spacing_mm)
    outlines = _filled(
        outlines, np.bincount(owner[distance < 0.8 * sizes[owner]], minlength=len(place)), sizes, spacing_mm
    )
    judged = [
        _judged(pose, [outlines[k] for k in own], part, spacing_mm)
        for pose, own in zip(poses, which.reshape(len(poses), -1), strict=True)
    ]
    return sorted(judged, key=lambda pose: -pose.score)


def _turn(pose: PatternPose) -> Array:
    """Rotation (2, 2) of the part's directions into the plane's."""
    c, s = np.cos(pose.clocking_rad), np.sin(pose.clocking_rad)
    return np.array([[c, -s], [s, c]])


def _distinct(places: Array, within_mm: float) -> tuple[Array, NDArray[np.intp]]:
    """Places (k, 2) of which none lies within a distance of another, and the one of them that stands for each (n,)."""
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    chosen: list[int] = []
    for k, near in enumerate(apart <= within_mm):
        if not near[chosen].any():
            chosen.append(k)
    return places[chosen], apart[:, chosen].argmin(axis=1)


def _filled(outlines: list[Outline], inside: NDArray[np.intp], sizes: Array, spacing_mm: float) -> list[Outline]:
    """The outlines with `fill` not below that of their places: one that went astray says nothing about its place."""
    whole = np.pi * (0.8 * sizes) ** 2 / spacing_mm**2
    return [
        replace(outline, fill=max(outline.fill, float(share) - ASIDE))
        for outline, share in zip(outlines, inside / whole, strict=True)
    ]


def _judged(pose: PatternPose, outlines: list[Outline], part: Part, spacing_mm: float) -> PatternPose:
    """One pose with its score; the distance of an outline from its place is that to the pattern fitted to them all."""
    turn = _turn(pose)
    arcs = np.array([0.0 if outline.fill > CLOSED else outline.arc for outline in outlines])
    trusted = arcs > (WHOLE if np.count_nonzero(arcs > WHOLE) >= 3 else LEAST_SEEN)
    centres = np.array([(outline.centre_mm - pose.centre_mm) @ turn for outline in outlines])
    covariances = np.array([turn.T @ one.covariance @ turn + PLACE_SIGMA_MM**2 * np.eye(2) for one in outlines])
    if np.count_nonzero(trusted) < 3:
        return replace(pose, score=0.0)
    fitted = fit_pattern(part, np.where(trusted[:, None], centres, np.nan), covariances, 0.0)
    misses = np.hypot(*(centres - placed(part, fitted)).T)
    return PatternPose(
        centre_mm=pose.centre_mm + turn @ fitted.centre_mm,
        clocking_rad=pose.clocking_rad + fitted.clocking_rad,
        matched=pose.matched,
        score=sum(_alike(outline, float(miss), spacing_mm) for outline, miss in zip(outlines, misses, strict=True)),
    )


def _alike(outline: Outline, miss_mm: float, spacing_mm: float) -> float:
    if outline.fill > CLOSED:
        return -1.0
    rough, off = outline.scatter_mm / (ROUND * spacing_mm), miss_mm / (PLACED * spacing_mm)
    return outline.arc / (1.0 + rough**2) / (1.0 + off**2)
