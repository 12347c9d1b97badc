"""The studs on a face: found by the nominal pattern, then all of them fitted together as real helices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cellctl.vision.geometry import Array, PlaneFrame, Points
from cellctl.vision.grid import find_islands, rasterise, spacing
from cellctl.vision.part import FaceFit, FeatureFit, Part, Refused, Thread, ThreadFit, pivot
from cellctl.vision.pattern import find_pattern, nominal
from cellctl.vision.thread_solve import Priors, Solution, best_phase, solve
from cellctl.vision.thread_surface import OWN, TIP, Form, Rays
from cellctl.vision.thread_vote import ThreadVote, check_vote, vote

AXIS_PRIOR_DEG = 0.03
"""One sigma of a stud's lean against the face's normal: a tapped hole's perpendicularity, with room to spare."""
MIN_POINTS = 25
"""Fewer points on a stud's thread and lead-in do not fix its axis."""
MIN_SHARE = 0.5
"""A smaller share of the points around a stud that fit it means that it is something else."""
MIN_VOTERS, CLEAR_VOTE = 100, 0.35
"""Points and score with which one stud alone says what thread it has."""


@dataclass(frozen=True, slots=True)
class _Seen:
    """Points near the studs in the face's frame, with the pixel (N,) each came from; tips (n,) above the face."""

    rays: Rays
    pixels: NDArray[np.intp]
    tips: Array


def measure_studs(
    points: Points,
    face: FaceFit,
    part: Part,
    T_scanner_part: Array | None = None,
    *,
    viewpoint: Array | None = None,
    reference: Array | None = None,
    axis_prior_deg: float = AXIS_PRIOR_DEG,
) -> tuple[FeatureFit, ...]:
    """One `FeatureFit` per feature of the pattern, in the frame of `points`; those not seen say why.

    `points` (..., 3) in mm, organised (H, W, 3) where neighbours shall be used; `face` in the same frame. The pattern
    is searched for unless `T_scanner_part` (4, 4) gives its pose; with no index its zero is then the nearest
    equivalent to `reference` (3,) (x axis). `viewpoint` (3,) is the camera's pinhole (origin). Axis: fit of the
    helix's flanks, crests and lead-in, the face's normal as prior with `axis_prior_deg`, which stands in the
    covariance. Raises Refused (features_missing, pattern_ambiguous, thread_wrong).
    """
    frame = PlaneFrame.on(face.point_mm, face.normal, np.array([1.0, 0.0, 0.0]) if reference is None else reference)
    eye = frame.into(np.zeros(3) if viewpoint is None else viewpoint)
    flat = points.reshape(-1, 3)
    length, radius = _length(part), _radius(part)
    chosen = np.flatnonzero(_within(flat, frame, length))
    local = frame.into(flat[chosen])
    centres = _pattern(local, part, frame, T_scanner_part, length, radius)
    bevel = part.thread.pitch_mm if part.thread else 0.25 * radius
    seen = _gather(local, chosen, centres, eye, length, radius, max(bevel, 0.25 * radius))
    counts = np.bincount(seen.rays.stud, minlength=part.count)
    if np.count_nonzero(counts >= MIN_POINTS) < 3:
        raise Refused("features_missing", "fewer than three studs stand on the face")
    solution, form, ballot = _fit(seen, centres, part, length, radius, axis_prior_deg, points.shape[:-1])
    return _results(solution, form, ballot, seen, frame, part)


def _length(part: Part) -> float:
    if part.length_mm is None:
        raise Refused("wrong_part", "the recipe gives no length of the studs")
    return part.length_mm


def _radius(part: Part) -> float:
    if part.thread is not None:
        return 0.5 * part.thread.major_diameter_mm
    if part.diameter_mm is None:
        raise Refused("wrong_part", "the recipe gives neither thread nor diameter of the studs")
    return 0.5 * float(np.median(part.diameter_mm))


def _within(flat: Points, frame: PlaneFrame, length: float) -> Array:
    """Which points stand above the face, no higher than a stud."""
    normal = frame.axes[2].astype(flat.dtype)
    height = flat @ normal - flat.dtype.type(frame.origin @ frame.axes[2])
    with np.errstate(invalid="ignore"):
        return np.asarray((height > 0.03 * length) & (height < length + 1.0))


def _pattern(
    local: Array, part: Part, frame: PlaneFrame, T_scanner_part: Array | None, length: float, radius: float
) -> Array:
    """Expected axes (n, 2) on the face: from the given pose, or from the tips' pattern without any prior clocking."""
    if T_scanner_part is not None:
        outline = np.column_stack([nominal(part), np.zeros(part.count)])
        return frame.into(outline @ T_scanner_part[:3, :3].T + T_scanner_part[:3, 3])[:, :2]
    tips = local[np.abs(local[:, 2] - length) < 0.05 * length + 0.5, :2]
    if len(tips) < 3 * 4:
        raise Refused("features_missing", "nothing stands on the face at the height of the studs")
    cell = max(1.2 * spacing(tips, coarse_mm=radius), 0.1 * radius)
    islands = [v for v in find_islands(rasterise(tips, cell, 2 * radius)) if 0.3 < v.radius_mm / radius < 2.0]
    if len(islands) < 3:
        raise Refused("features_missing", "fewer than three studs stand on the face")
    places = np.array([island.position_mm for island in islands])
    sizes = np.array([island.radius_mm for island in islands])
    found = find_pattern(part, places, sizes, np.ones(len(places)), 0.25 * radius)
    if found is None:
        raise Refused("features_missing", "the studs that were seen do not make the pattern")
    c, s = np.cos(found.clocking_rad), np.sin(found.clocking_rad)
    return np.asarray(found.centre_mm + nominal(part) @ np.array([[c, s], [-s, c]]))


def _gather(
    local: Array, pixels: NDArray[np.intp], centres: Array, eye: Array, length: float, radius: float, bevel: float
) -> _Seen:
    """Points within reach of a stud. The flat end gives the stud's height and is left out within `bevel` of its rim."""
    reach = 1.15 * radius + 0.3
    distance, nearest = cKDTree(centres).query(local[:, :2], distance_upper_bound=reach)
    near = np.flatnonzero(np.isfinite(distance))
    stud, from_axis = np.asarray(nearest, dtype=np.intp)[near], np.asarray(distance)[near]
    tips = np.full(len(centres), length)
    for i in range(len(centres)):
        flat = local[near[(stud == i) & (from_axis < 0.6 * radius)], 2]
        flat = flat[flat > 0.9 * length]
        if len(flat) >= 5:
            tips[i] = np.median(flat)
    side = (local[near, 2] < tips[stud] + 0.3) & (from_axis > radius - bevel)
    near, stud = near[side], stud[side]
    rays = local[near] - eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return _Seen(Rays(local[near], rays, stud), pixels[near], tips)


def _fit(
    seen: _Seen, centres: Array, part: Part, length: float, radius: float, axis_prior_deg: float, shape: tuple[int, ...]
) -> tuple[Solution, Form, ThreadVote | None]:
    """Vote for the thread, then least squares of every stud with one common thread."""
    count, rays = len(centres), seen.rays
    pitch = part.thread.pitch_mm if part.thread else 1.0
    own = np.zeros((count, OWN))
    own[:, :2] = centres
    own[:, 5] = seen.tips + radius - 0.6 * pitch
    ballot = None
    hand, starts, middle = 0, 1, 0.5 * length
    if part.thread is not None:
        ballot = _vote(rays, centres, seen.tips, pitch)
        check_vote(ballot, part.thread)
        hand, starts = (1 if ballot.hand == "right" else -1), ballot.starts
        own[:, 4] = ballot.phase_mm - middle
    form = Form(hand, starts, middle, seen.tips)
    lean = np.radians(axis_prior_deg)
    priors = Priors(np.array([2.0, 2.0, lean, lean, np.inf, 1.0]), np.array([0.04, 1e-4, 0.05]))
    shared = np.array([radius, pitch / 16.0, ballot.pitch_mm if ballot else pitch])
    if ballot is not None:
        own[:, 4] = best_phase(rays, own, shared, form)
    return solve(rays, own, shared, form, priors, pixels=seen.pixels, shape=shape), form, ballot


def _vote(rays: Rays, centres: Array, tips: Array, pitch: float) -> ThreadVote:
    offset = rays.points[:, :2] - centres[rays.stud]
    height = rays.points[:, 2]
    side = np.flatnonzero((height > 2.0) & (height < tips[rays.stud] - 1.2 * pitch))
    if len(side) < 50:
        raise Refused("too_few_points", "too few points on the flanks of the studs")
    radius, angle = np.hypot(*offset[side].T), np.arctan2(offset[side, 1], offset[side, 0])
    return vote(
        radius, angle, height[side], rays.stud[side], len(centres), pitch_low_mm=0.45 * pitch, pitch_high_mm=2.2 * pitch
    )


def _results(
    solution: Solution, form: Form, ballot: ThreadVote | None, seen: _Seen, frame: PlaneFrame, part: Part
) -> tuple[FeatureFit, ...]:
    on_side = solution.surface < TIP
    used = (solution.weights > 0) & on_side
    fits = []
    for i in range(part.count):
        mine = (seen.rays.stud == i) & on_side
        fit, there = int(np.count_nonzero(used & mine)), int(np.count_nonzero(mine))
        reason = _why_not(fit, there, solution.own_covariance[i])
        if not reason:
            rms = float(np.sqrt(np.mean(solution.residuals_mm[used & mine] ** 2)))
            fits.append(_found(i, solution, form, ballot, frame, fit, rms))
            continue
        if part.thread is not None and there >= MIN_VOTERS:
            _check_alone(i, seen, solution.own[i], part.thread)
        fits.append(FeatureFit(i, False, points=fit, reason=reason))
    return tuple(fits)


def _found(
    index: int,
    solution: Solution,
    form: Form,
    ballot: ThreadVote | None,
    frame: PlaneFrame,
    points: int,
    residual_mm: float,
) -> FeatureFit:
    own, covariance = solution.own[index], solution.own_covariance[index]
    axis = np.array([own[2], own[3], 1.0])
    return FeatureFit(
        index=index,
        found=True,
        center_mm=frame.out(np.array([own[0], own[1], 0.0])),
        axis=axis @ frame.axes / np.linalg.norm(axis),
        radius_mm=float(solution.shared[0]),
        covariance_mm2=frame.axes[:2].T @ covariance[:2, :2] @ frame.axes[:2],
        axis_sigma_deg=float(np.degrees(np.sqrt(np.trace(covariance[2:4, 2:4]) / 2.0))),
        pivot_mm=pivot(covariance[:4, :4]),
        thread=_thread(solution, form, ballot, own),
        points=points,
        residual_mm=residual_mm,
    )


def _check_alone(index: int, seen: _Seen, own: Array, expected: Thread) -> None:
    """A stud that does not go with the others may carry another thread: let its points vote alone."""
    mine = np.flatnonzero(seen.rays.stud == index)
    rays = seen.rays.take(mine)
    alone = Rays(rays.points, rays.directions, np.zeros(len(mine), dtype=np.intp))
    try:
        ballot = _vote(alone, own[None, :2], seen.tips[index : index + 1], expected.pitch_mm)
    except Refused:
        return
    if ballot.score > CLEAR_VOTE:
        check_vote(ballot, expected, f"stud {index}: ")


def _thread(solution: Solution, form: Form, ballot: ThreadVote | None, own: Array) -> ThreadFit | None:
    if ballot is None:
        return None
    radius, _, pitch = (float(value) for value in solution.shared)
    sigma = np.sqrt(np.diag(solution.shared_covariance))
    phase = float((own[4] + form.middle_mm) / pitch * 2.0 * np.pi % (2.0 * np.pi))
    return ThreadFit(radius, pitch, ballot.hand, ballot.starts, phase, float(sigma[0]), float(sigma[2]))


def _why_not(used: int, there: int, covariance: Array) -> str:
    """Reason why a stud counts as not found, "" where it does."""
    if there < MIN_POINTS:
        return "nothing stands there"
    if used < MIN_POINTS or used < MIN_SHARE * there:
        return f"only {used} of {there} points there fit a stud"
    if np.sqrt(np.trace(covariance[:2, :2])) > 0.5:
        return "its axis is not determined"
    return ""
