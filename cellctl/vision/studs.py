"""The studs on a face: found by the nominal pattern, then all of them fitted together as real helices."""

from __future__ import annotations

import numpy as np

from cellctl.vision.columns import Columns
from cellctl.vision.geometry import Array, PlaneFrame, Points
from cellctl.vision.grid import spacing
from cellctl.vision.part import FaceFit, FeatureFit, Part, Refused, Thread, ThreadFit, pivot
from cellctl.vision.pattern import find_pattern, nominal, placed
from cellctl.vision.stud_checks import check_count, check_length, check_radius, check_sides
from cellctl.vision.stud_points import LEAST_HEIGHT_MM, Near, gather
from cellctl.vision.stud_tips import find_tips, radius_of, tip_levels
from cellctl.vision.thread_normal import Priors
from cellctl.vision.thread_solve import Solution, solve
from cellctl.vision.thread_start import Start, best_lead_in, best_phase, seekers, thinned
from cellctl.vision.thread_surface import OWN, PITCH, RADIUS, ROOT_PITCHES, TIP, Form, Rays
from cellctl.vision.thread_vote import ThreadVote, check_vote, shows, vote

AXIS_PRIOR_DEG = 0.02
"""One sigma of a stud's lean against the face's normal: what a tapped hole's perpendicularity allows."""
MIN_POINTS = 12
"""Fewer points on a stud's thread and lead-in do not fix its axis."""
MIN_SHARE, USUAL_SHARE = 0.5, 0.75
"""A smaller share of the points around a stud that fit it, or of what fits the other studs, means something else."""
MIN_VOTERS, CLEAR_VOTE = 100, 0.35
"""Points and score with which one stud alone says what thread it has."""
VOTERS = 200
"""Points of a stud that vote."""
LEAD_IN_PITCHES = np.array([0.0, 0.35, 0.6, 0.9, 1.3, 1.9, 2.7])


def measure_studs(
    points: Points | Columns,
    face: FaceFit,
    part: Part,
    T_scanner_part: Array | None = None,
    *,
    viewpoint: Array | None = None,
    reference: Array | None = None,
    axis_prior_deg: float = AXIS_PRIOR_DEG,
) -> tuple[FeatureFit, ...]:
    """One `FeatureFit` per feature of the pattern, in the frame of `points`; those not seen say why.

    `points` (..., 3) in mm or as columns, organised where neighbours shall be used; `face` in the same frame. The
    pattern is searched for unless `T_scanner_part` (4, 4) gives its pose; with no index its zero is then the nearest
    equivalent to `reference` (3,) (x axis). `viewpoint` (3,) is the camera's pinhole (origin). Sizes that `part` does
    not give are estimated, and a thread is looked for. Axis: fit of the helix's flanks, crests and lead-in; the face's
    normal is its prior with `axis_prior_deg`, or wider where the studs show that they lean more. Raises Refused
    (features_missing, pattern_ambiguous, thread_wrong, wrong_part).
    """
    frame = PlaneFrame.on(face.point_mm, face.normal, np.array([1.0, 0.0, 0.0]) if reference is None else reference)
    eye = frame.into(np.zeros(3) if viewpoint is None else viewpoint)
    scan = points if isinstance(points, Columns) else Columns.of(points)
    above = _above(scan, face, part)
    local = _into(above, frame)
    centres = _pattern(local, part, frame, T_scanner_part)
    near = gather(local, above.pixels, centres, part, eye)
    if np.count_nonzero(near.counts >= MIN_POINTS) < 3:
        raise Refused("features_missing", "fewer than three studs stand on the face")
    check_length(near, part, MIN_POINTS)
    check_count(local, near, part)
    solution, form, ballot = _fit(near, part, np.radians(axis_prior_deg), face.sigma_mm, above.shape)
    check_radius(float(solution.shared[RADIUS]), part)
    check_sides(near, solution.own[:, :2], part)
    return _results(solution, form, ballot, near, frame, face, part)


def _above(scan: Columns, face: FaceFit, part: Part) -> Columns:
    """Points above the face, no higher than a stud."""
    low = max(LEAST_HEIGHT_MM, 8.0 * face.sigma_mm)
    high = 1.3 * part.length_mm + 3.0 if part.length_mm is not None else 2.0 * part.circle_diameter_mm
    rows = [np.zeros(0, dtype=np.intp)]
    for begin, piece in scan.batches():
        height = piece.above(face.normal, float(face.point_mm @ face.normal))
        rows.append(begin + np.flatnonzero((height > low) & (height < high)))
    return scan.take(np.concatenate(rows))


def _into(points: Columns, frame: PlaneFrame) -> Array:
    """(3, N) coordinates in the face's frame, float64."""
    offsets = np.stack([points.x, points.y, points.z], dtype=np.float64) - frame.origin[:, None]
    return np.asarray(np.einsum("ij,jn->in", frame.axes, offsets))


def _pattern(local: Array, part: Part, frame: PlaneFrame, T_scanner_part: Array | None) -> Array:
    """Expected axes (n, 2) on the face: from the given pose, or from the tips' pattern without any prior clocking."""
    if T_scanner_part is not None:
        outline = np.column_stack([nominal(part), np.zeros(part.count)])
        return frame.into(outline @ T_scanner_part[:3, :3].T + T_scanner_part[:3, 3])[:, :2]
    radius = radius_of(part) or 0.015 * part.circle_diameter_mm
    for level in tip_levels(local[2], part):
        on = np.abs(local[2] - level) < 0.4
        tips = find_tips(local[:2].T, local[2], part, spacing(local[:2, on].T, coarse_mm=radius), level)
        if len(tips) < 3:
            continue
        places = np.array([tip.position_mm for tip in tips])
        sizes = np.array([tip.radius_mm for tip in tips])
        found = find_pattern(part, places, sizes, np.ones(len(places)), max(0.25 * radius, 0.5))
        if found is not None:
            return placed(part, found)
    raise Refused("features_missing", "no studs in the pattern stand on the face")


def _fit(
    near: Near, part: Part, lean_rad: float, noise_mm: float, shape: tuple[int, ...]
) -> tuple[Solution, Form, ThreadVote | None]:
    """Vote for the thread, then least squares of every stud with one common thread."""
    ballot = _ballot(near, part)
    pitch = ballot.pitch_mm if ballot else 0.25 * near.radius_mm
    length = float(np.median(near.tips))
    own = np.zeros((len(near.tips), OWN))
    own[:, :2] = near.middles
    own[:, 5] = near.tips - 0.6 * pitch
    form = Form(0, 1, 0.5 * length, near.tips, near.extra_mm)
    shared = np.array([near.radius_mm, pitch / 16.0, pitch, 1.0, near.radius_mm - ROOT_PITCHES * pitch])
    some = seekers(near.rays)
    if ballot is not None:
        form = Form(1 if ballot.hand == "right" else -1, ballot.starts, 0.5 * length, near.tips, near.extra_mm)
        own[:, 4] = ballot.phase_mm - form.middle_mm
        own[:, 4] = best_phase(some, own, shared, form)
    own[:, 5] = near.tips - best_lead_in(some, own, shared, form, LEAD_IN_PITCHES * pitch)
    spread = np.array([0.1, 0.03 * pitch, 0.05 * pitch, 0.3, 0.1 * pitch])
    if ballot is None:
        spread[1:3] = 1e-6
    priors = Priors(np.array([2.0, 2.0, lean_rad, lean_rad, np.inf, 1.0]), spread)
    start = Start(own, shared, priors, form, near.expected, noise_mm)
    return solve(near.rays, start, pixels=near.pixels, shape=shape), form, ballot


def _ballot(near: Near, part: Part) -> ThreadVote | None:
    """What thread the studs carry together; None for plain pins where the recipe asks for no thread."""
    try:
        ballot = _vote(near.rays.take(thinned(near.rays.stud, VOTERS)), near, part.thread)
    except Refused:
        if part.thread is not None:
            raise
        return None
    if part.thread is not None:
        check_vote(ballot, part.thread)
    return ballot if shows(ballot) else None


def _vote(rays: Rays, near: Near, expected: Thread | None) -> ThreadVote:
    x, y = rays.points[:2] - near.middles.T[:, rays.stud]
    height = rays.points[2]
    pitch = expected.pitch_mm if expected is not None else 0.25 * near.radius_mm
    side = np.flatnonzero((height > 2.0) & (height < near.tips[rays.stud] - 1.2 * pitch))
    if len(side) < 50:
        raise Refused("too_few_points", "too few points on the flanks of the studs")
    low, high = (0.45 * pitch, 2.2 * pitch) if expected is not None else (0.08 * near.radius_mm, 0.6 * near.radius_mm)
    return vote(
        np.sqrt(x * x + y * y)[side], np.arctan2(y, x)[side], height[side], rays.stud[side], len(near.tips),
        pitch_low_mm=low, pitch_high_mm=high, max_starts=max(3, expected.starts if expected is not None else 0),
        expected=expected,
    )  # fmt: skip


def _results(
    solution: Solution, form: Form, ballot: ThreadVote | None, near: Near, frame: PlaneFrame, face: FaceFit, part: Part
) -> tuple[FeatureFit, ...]:
    on_side = solution.surface < TIP
    used = (solution.weights > 0) & on_side
    counts = [np.bincount(near.rays.stud[chosen], minlength=part.count) for chosen in (used, on_side)]
    seen = counts[1] >= MIN_POINTS
    usual = float(np.median((counts[0] / np.maximum(counts[1], 1))[seen])) if seen.any() else 1.0
    fits = []
    for i, (fit, there) in enumerate(np.stack(counts, axis=1).tolist()):
        mine = slice(near.starts[i], near.starts[i + 1])
        by_chance = 2.0 * np.sqrt(usual * (1.0 - usual) / max(there, 1))
        reason = _why_not(fit, there, max(MIN_SHARE, USUAL_SHARE * usual - by_chance), solution.own_covariance[i])
        if not reason:
            rms = float(np.sqrt(np.mean(solution.residuals_mm[mine][used[mine]] ** 2)))
            fits.append(_found(i, solution, form, ballot, frame, face, fit, rms))
            continue
        if part.thread is not None and there >= MIN_VOTERS:
            _check_alone(i, near, part.thread)
        fits.append(FeatureFit(i, False, points=fit, reason=reason))
    return tuple(fits)


def _found(
    index: int, solution: Solution, form: Form, ballot: ThreadVote | None, frame: PlaneFrame, face: FaceFit,
    points: int, residual_mm: float,
) -> FeatureFit:  # fmt: skip
    own, covariance = solution.own[index], solution.own_covariance[index]
    axis = np.array([own[2], own[3], 1.0])
    centre = frame.out(np.array([own[0], own[1], 0.0]))
    # the centre lies on the face, so the face's height joins its covariance
    arm = face.tilt_axes @ (centre - face.point_mm)
    lever = np.array([1.0, arm[1], -arm[0]])
    spread = np.zeros((3, 3))
    spread[:2, :2] = covariance[:2, :2]
    spread[2, 2] = lever @ face.covariance @ lever
    return FeatureFit(
        index=index,
        found=True,
        center_mm=centre,
        axis=axis @ frame.axes / np.linalg.norm(axis),
        radius_mm=float(solution.shared[0] + form.extra_mm[index]),
        covariance_mm2=frame.axes.T @ spread @ frame.axes,
        axis_sigma_deg=float(np.degrees(np.sqrt(np.trace(covariance[2:4, 2:4]) / 2.0))),
        pivot_mm=pivot(covariance[:4, :4]),
        thread=_thread(solution, form, ballot, own),
        points=points,
        residual_mm=residual_mm,
    )


def _check_alone(index: int, near: Near, expected: Thread) -> None:
    """A stud that does not go with the others may carry another thread: let its points vote alone."""
    rays = near.rays.take(slice(near.starts[index], near.starts[index + 1]))
    try:
        ballot = _vote(Rays(rays.points, rays.directions, np.zeros_like(rays.stud)), near.only(index), expected)
    except Refused:
        return
    if ballot.score > CLEAR_VOTE:
        check_vote(ballot, expected, f"stud {index}: ")


def _thread(solution: Solution, form: Form, ballot: ThreadVote | None, own: Array) -> ThreadFit | None:
    if ballot is None:
        return None
    radius, pitch = float(solution.shared[RADIUS]), float(solution.shared[PITCH])
    sigma = np.sqrt(np.diag(solution.shared_covariance))
    phase = float((own[4] + form.middle_mm) / pitch * 2.0 * np.pi % (2.0 * np.pi))
    return ThreadFit(radius, pitch, ballot.hand, ballot.starts, phase, float(sigma[RADIUS]), float(sigma[PITCH]))


def _why_not(used: int, there: int, share: float, covariance: Array) -> str:
    """Reason why a stud counts as not found, "" where it does."""
    if there < MIN_POINTS:
        return "nothing stands there"
    if used < MIN_POINTS or used < share * there:
        return f"only {used} of {there} points there fit a stud"
    if np.sqrt(np.trace(covariance[:2, :2])) > 0.5:
        return "its axis is not determined"
    return ""
