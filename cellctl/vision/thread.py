"""One thread by itself, from a close-up: crest clusters, vote, then least squares (eq. 10-13, corrected). Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.cluster import crest_points
from cellctl.vision.geometry import Array, PlaneFrame
from cellctl.vision.part import Refused, Thread, ThreadFit
from cellctl.vision.pca import principal
from cellctl.vision.thread_normal import Priors
from cellctl.vision.thread_solve import Solution, solve
from cellctl.vision.thread_start import Start, best_phase, seekers
from cellctl.vision.thread_surface import LEAD_IN, OWN, PITCH, RADIUS, ROOT_PITCHES, Form, Rays
from cellctl.vision.thread_vote import ThreadVote, check_vote, shows, vote

MIN_POINTS = 200
CREST_BAND = 0.15
"""How deep the crest's band reaches, in pitches: a quarter of the thread's depth."""
FAR_MM = 1e6
"""Height of tip and lead-in where they are not part of the problem."""


@dataclass(frozen=True, slots=True)
class ThreadResult:
    """A thread as measured: sizes, a point on its axis (3,), unit direction (3,) towards the camera.

    `covariance` (4, 4), type A: the axis' place across it at `point_mm` (mm2) and its two slopes (rad2), along
    `across` (2, 3). `crest` (N,) points of the input on the crest's band; `inliers` the share of points that fit,
    `sigma_mm` their robust noise along the ray, `radius_from_crest_mm` the crest's radius by its shell alone.
    """

    thread: ThreadFit
    point_mm: Array
    direction: Array
    across: Array
    covariance: Array
    crest: NDArray[np.bool_]
    inliers: float
    sigma_mm: float
    radius_from_crest_mm: float


def fit_thread(
    points: Array,
    *,
    nominal: Thread | None = None,
    viewpoint: Array | None = None,
    axis: tuple[Array, Array] | None = None,
    pixels: NDArray[np.intp] | None = None,
    shape: tuple[int, ...] = (),
    noise_mm: float = 0.03,
) -> ThreadResult:
    """Fit one external 60 degree thread to points (N, 3) on and near it, mm.

    `viewpoint` (3,) is the camera's pinhole (origin); `axis` (point, direction) a start, else principal components
    and a cylinder. `pixels` and `shape` as in `thread_solve.solve`. Raises Refused (too_few_points, not_finite,
    thread_wrong where it is not `nominal`).
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < MIN_POINTS:
        raise Refused("too_few_points", f"{len(points)} points, a thread needs {MIN_POINTS}")
    eye = np.zeros(3) if viewpoint is None else viewpoint
    place, direction = axis if axis is not None else _axis_start(points)
    direction = direction * np.sign(direction @ (eye - place)) / np.linalg.norm(direction)
    frame = PlaneFrame.on(place, direction)
    local = frame.into(points)
    rows = _threaded(local, nominal)
    local = local[rows]
    radius, angle = np.hypot(local[:, 0], local[:, 1]), np.arctan2(local[:, 1], local[:, 0])
    alone = np.zeros(len(rows), dtype=np.intp)
    low, high = (0.45 * nominal.pitch_mm, 2.2 * nominal.pitch_mm) if nominal is not None else (0.4, 3.0)
    ballot = vote(radius, angle, local[:, 2], alone, 1, pitch_low_mm=low, pitch_high_mm=high, expected=nominal)
    if nominal is not None:
        check_vote(ballot, nominal)
    elif not shows(ballot):
        raise Refused("thread_wrong", f"no thread shows in the points (vote {ballot.score:.3f})")
    _, crest = crest_points(local, noise_mm=noise_mm, depth_mm=CREST_BAND * ballot.pitch_mm)
    rays = (local - frame.into(eye)).T
    rays /= np.sqrt(np.sum(rays * rays, axis=0))
    chosen = pixels[rows] if pixels is not None else None
    solution, form = _solve(Rays(np.ascontiguousarray(local.T), rays, alone), ballot, crest, chosen, shape)
    _check_radius(float(solution.shared[0]), nominal)
    return _result(solution, form, ballot, frame, points, rows, noise_mm)


def _axis_start(points: Array) -> tuple[Array, Array]:
    """Axis from the principal components, moved to the middle of a robust cylinder: a start for the fit."""
    parts = principal(points)
    scores = parts.scores(points)
    flat = scores[:, 1:]
    design = np.column_stack([2.0 * flat, np.ones(len(flat))])
    centre = np.linalg.lstsq(design, np.sum(flat**2, axis=1), rcond=None)[0]
    x = np.array([centre[0], centre[1], 0.0, 0.0, np.sqrt(max(centre[2] + centre[0] ** 2 + centre[1] ** 2, 1e-6))])
    for _ in range(30):
        dx, dy = flat[:, 0] - x[0] - x[2] * scores[:, 0], flat[:, 1] - x[1] - x[3] * scores[:, 0]
        r = np.maximum(np.hypot(dx, dy), 1e-9)
        miss = r - x[4]
        spread = 1.4826 * float(np.median(np.abs(miss))) + 1e-9
        weight = 1.0 / np.maximum(1.0, np.abs(miss) / (1.5 * spread))
        c, s = -dx / r, -dy / r
        jacobian = np.column_stack([c, s, c * scores[:, 0], s * scores[:, 0], -np.ones(len(r))])
        step = np.linalg.lstsq(jacobian * weight[:, None], -miss * weight, rcond=1e-10)[0]
        x = x + step
        if np.abs(step).max() < 1e-6:
            break
    direction = np.array([1.0, x[2], x[3]]) @ parts.axes
    return parts.mean + np.array([0.0, x[0], x[1]]) @ parts.axes, direction / np.linalg.norm(direction)


def _threaded(local: Array, nominal: Thread | None) -> NDArray[np.intp]:
    """Points on the flanks: neither the ends with their lead-in nor what lies far from the common radius."""
    radius = np.hypot(local[:, 0], local[:, 1])
    middle, spread = np.median(radius), 1.4826 * np.median(np.abs(radius - np.median(radius)))
    near = np.abs(radius - middle) < 5.0 * spread + 1e-6
    low, high = np.percentile(local[near, 2], [0.5, 99.5])
    margin = 1.3 * nominal.pitch_mm if nominal is not None else 0.05 * (high - low)
    rows = np.flatnonzero(near & (local[:, 2] > low + margin) & (local[:, 2] < high - margin))
    if len(rows) < MIN_POINTS:
        raise Refused("too_few_points", f"{len(rows)} points on the thread, {MIN_POINTS} are needed")
    return rows


def _solve(
    rays: Rays, ballot: ThreadVote, crest_mm: float, pixels: NDArray[np.intp] | None, shape: tuple[int, ...]
) -> tuple[Solution, Form]:
    pitch = ballot.pitch_mm
    form = Form(1 if ballot.hand == "right" else -1, ballot.starts, 0.0, np.array([FAR_MM]), np.zeros(1))
    own = np.zeros((1, OWN))
    own[0, 4], own[0, 5] = ballot.phase_mm[0], FAR_MM
    shared = np.array([crest_mm, pitch / 16.0, pitch, 1.0, crest_mm - ROOT_PITCHES * pitch])
    own[:, 4] = best_phase(seekers(rays), own, shared, form, steps=32)
    spread = np.array([0.3, 0.03 * pitch, 0.05 * pitch, 1e-3, 0.1 * pitch])
    priors = Priors(np.array([2.0, 2.0, 0.1, 0.1, np.inf, 1e-3]), spread)
    return solve(rays, Start(own, shared, priors, form), pixels=pixels, shape=shape), form


def _check_radius(radius: float, nominal: Thread | None) -> None:
    if nominal is None:
        return
    expected = 0.5 * nominal.major_diameter_mm
    if abs(radius - expected) > 0.1 + 0.02 * expected:
        raise Refused("thread_wrong", f"crest radius {radius:.3f} mm; the recipe says {expected:.3f} mm")


def _result(
    solution: Solution,
    form: Form,
    ballot: ThreadVote,
    frame: PlaneFrame,
    points: Array,
    rows: NDArray[np.intp],
    noise_mm: float,
) -> ThreadResult:
    radius, pitch = float(solution.shared[RADIUS]), float(solution.shared[PITCH])
    own = solution.own[0]
    used = (solution.weights > 0) & (solution.surface < LEAD_IN)
    place = frame.out(np.array([own[0], own[1], 0.0]))
    sigmas = np.sqrt(np.diag(solution.shared_covariance))
    direction = np.array([own[2], own[3], 1.0]) @ frame.axes
    direction /= np.linalg.norm(direction)
    crest = np.zeros(len(points), dtype=np.bool_)
    upright = PlaneFrame.on(place, direction).into(points[rows])
    crest[rows], crest_mm = crest_points(upright, noise_mm=noise_mm, depth_mm=CREST_BAND * pitch)
    return ThreadResult(
        thread=ThreadFit(
            radius_mm=radius,
            pitch_mm=pitch,
            hand=ballot.hand,
            starts=ballot.starts,
            phase_rad=float((own[4] + form.middle_mm) / pitch * 2.0 * np.pi % (2.0 * np.pi)),
            sigma_radius_mm=float(sigmas[RADIUS]),
            sigma_pitch_mm=float(sigmas[PITCH]),
        ),
        point_mm=place,
        direction=direction,
        across=frame.axes[:2],
        covariance=solution.own_covariance[0, :4, :4],
        crest=crest,
        inliers=float(used.mean()),
        sigma_mm=1.4826 * float(np.median(np.abs(solution.residuals_mm[used]))),
        radius_from_crest_mm=crest_mm,
    )
