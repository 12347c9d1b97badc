"""Robust least squares of threaded studs on the depth along each ray: own parameters per stud, shared ones for all.

Some points bring the fit near; all points decide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.correlation import Correlation, PixelGrid, Whitener, estimate
from cellctl.vision.thread_noise import NoiseLaw, learn, misfit, on_thread, scale_of, tukey
from cellctl.vision.thread_normal import Normal, Priors, lean_sigma
from cellctl.vision.thread_surface import FLANK, PITCH, RADIUS, Array, Depths, Form, Rays, depths

HELD_MM, HELD_ROUNDS = 1e-3, 5
"""The shared sizes stay at their start until the studs stand: freed at once, they may run off with the phases."""
ROUGH_POINTS, ROUGH_TOTAL = 150, 4000
"""Points of a stud, and of all studs where these are few, that bring the fit near."""
SEEKERS = 60
RADIUS_CHANGES_MM = (0.0, -0.02, 0.02, -0.05, 0.05, -0.08, 0.08, -0.12, 0.12, -0.17)
STILL_MM = 1e-4
FINAL_ROUNDS, STILL_SIGMAS = 8, 0.3
POOR_SHARE = 0.7
"""A stud of whose points a smaller share fits is tried again from another phase."""


@dataclass(frozen=True, slots=True)
class Solution:
    """`own` (n, OWN), `shared` (SHARED,) with their type A covariances (n, OWN, OWN), (SHARED, SHARED).

    `residuals_mm` (N,) predicted minus measured depth; `weights` (N,) robust, 0 for what is no thread; `law` of the
    noise along the ray; `correlation` of neighbouring pixels that was found in the residuals; `surface` (N,) met.
    """

    own: Array
    shared: Array
    own_covariance: Array
    shared_covariance: Array
    residuals_mm: Array
    weights: Array
    law: NoiseLaw
    surface: NDArray[np.int8]
    correlation: Correlation


@dataclass(frozen=True, slots=True)
class Start:
    """Where the fit begins: `own` (n, OWN), `shared` (SHARED,), what is known of them, and the thread's form."""

    own: Array
    shared: Array
    priors: Priors
    form: Form


def solve(rays: Rays, start: Start, *, pixels: NDArray[np.intp] | None = None, shape: tuple[int, ...] = ()) -> Solution:
    """Robust least squares to convergence, then rounds that also free the rows from what neighbouring pixels share.

    `rays` sorted by stud. `pixels` (N,) are flat indices into an organised cloud of `shape`; without them the noise
    counts as white.
    """
    some = rays.take(thinned(rays.stud, max(ROUGH_POINTS, ROUGH_TOTAL // len(start.own))))
    own, shared, law = approach(some, start, start.own, start.shared, 0.25)
    own, shared, law = _tried_again(some, start, own, shared, law)
    own, shared, law = _other_radius(some, start, own, shared, law)
    law = learn(depths(some, own, shared, start.form), law, shared[PITCH])
    own, shared, law = approach(some, start, own, shared, 0.0, law=law, rounds=4, held=0)
    return _finish(rays, start, own, shared, law, pixels, shape)


def thinned(stud: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Rows of at most about `most` evenly spread points of each stud; `stud` (N,) is sorted."""
    counts = np.bincount(stud)
    place = np.arange(len(stud)) - (np.cumsum(counts) - counts)[stud]
    step = np.maximum(1, -(-counts // most))[stud]
    return np.flatnonzero(place % step == 0)


def approach(
    rays: Rays, start: Start, own: Array, shared: Array, scale_mm: float, *, law: NoiseLaw | None = None,
    rounds: int = 16, held: int = HELD_ROUNDS,
) -> tuple[Array, Array, NoiseLaw]:  # fmt: skip
    """Gauss-Newton with Tukey weights whose scale falls from `scale_mm` to what the residuals show."""
    known, law = (start.own, start.shared), law or NoiseLaw(scale_mm)
    for turn in range(rounds):
        met = depths(rays, own, shared, start.form)
        law = scale_of(met, law, shared[PITCH], scale_mm * 0.5**turn if turn < 4 else 0.0)
        priors = start.priors
        if turn < held:
            priors = replace(priors, shared=np.minimum(priors.shared, HELD_MM))
        d_own, d_shared = _normal(met, law, shared, rays.stud, len(own)).step((own, shared), known, priors)
        own, shared = own + np.clip(d_own, -0.3, 0.3), shared + np.clip(d_shared, -0.1, 0.1)
        if turn > held + 1 and float(np.abs(d_own[:, [0, 1, 4]]).max()) < STILL_MM:
            break
    return own, shared, law


def _normal(met: Depths, law: NoiseLaw, shared: Array, stud: NDArray[np.intp], count: int) -> Normal:
    weights, sigmas = tukey(met, law, shared[PITCH])
    normal = Normal.empty(count)
    normal.add(_rows(met, sigmas), weights, stud)
    return normal


def _rows(met: Depths, sigmas: Array) -> Array:
    """Design and right-hand side (SIZE, N) in units of one sigma."""
    return np.concatenate([met.slopes, -np.nan_to_num(met.ahead_mm)[None]]) / sigmas


def _tried_again(rays: Rays, start: Start, own: Array, shared: Array, law: NoiseLaw) -> tuple[Array, Array, NoiseLaw]:
    """Studs that do not fit, once more from the phase that fits best beside the sizes which the others found."""
    before = _misfit(rays, own, shared, start.form, law)
    poor = before > 1.0 - POOR_SHARE
    if not poor.any() or not start.form.hand:
        return own, shared, law
    again = np.where(poor[:, None], start.own, own)
    again[:, 4] = np.where(poor, best_phase(rays, again, shared, start.form, steps=32), own[:, 4])
    again, _, _ = approach(rays, start, again, shared, 0.1, held=16)
    better = _misfit(rays, again, shared, start.form, law) < before
    return approach(rays, start, np.where(better[:, None], again, own), shared, 0.0, law=law, held=0)


def _other_radius(rays: Rays, start: Start, own: Array, shared: Array, law: NoiseLaw) -> tuple[Array, Array, NoiseLaw]:
    """The radius that fits best while the upper flanks stay where they are.

    Seen from above, a thread with too large a crest has its flanks in the right place and takes the crest's points for
    outliers: from there no small step leads on.
    """
    if not start.form.hand:
        return own, shared, law
    some = rays.take(thinned(rays.stud, max(SEEKERS, ROUGH_TOTAL // len(own))))
    losses = []
    for change in RADIUS_CHANGES_MM:
        met = depths(some, *_resized(own, shared, change), start.form)
        losses.append(float(misfit(met, law, shared[PITCH]).sum()))
    change = RADIUS_CHANGES_MM[int(np.argmin(losses))]
    if change == 0.0:
        return own, shared, law
    return approach(rays, start, *_resized(own, shared, change), 0.0, law=law, held=0)


def _resized(own: Array, shared: Array, change_mm: float) -> tuple[Array, Array]:
    """Other crest radius on the same upper flanks."""
    own, shared = own.copy(), shared.copy()
    shared[RADIUS] += change_mm
    own[:, 4] -= change_mm / FLANK
    return own, shared


def _misfit(rays: Rays, own: Array, shared: Array, form: Form, law: NoiseLaw) -> Array:
    """Share (n,) of each stud's points on thread and lead-in that do not fit."""
    met = depths(rays, own, shared, form)
    on, (weights, _) = on_thread(met, shared[PITCH]), tukey(met, law, shared[PITCH])
    there = np.bincount(rays.stud[on], minlength=len(own))
    return np.asarray(np.bincount(rays.stud[on & (weights == 0.0)], minlength=len(own)) / np.maximum(there, 1))


def _finish(
    rays: Rays, start: Start, own: Array, shared: Array, law: NoiseLaw, pixels: NDArray[np.intp] | None,
    shape: tuple[int, ...],
) -> Solution:  # fmt: skip
    """The last rounds, on all points; how much studs lean is learnt from all of them."""
    known, form, priors = (start.own, start.shared), start.form, start.priors
    factor = 1.0
    for turn in range(FINAL_ROUNDS):
        met = depths(rays, own, shared, form)
        law = learn(met, law, shared[PITCH]) if turn == 0 else law
        weights, sigmas = tukey(met, law, shared[PITCH])
        rows, kept, square, correlation = _independent(met, weights, sigmas, rays.stud, pixels, shape)
        normal = Normal.empty(len(own))
        normal.add(rows, square, rays.stud[kept])
        if turn == 0:
            if pixels is not None and len(shape) == 2:
                factor = normal.excess(rows, square, rays.stud[kept], _tiles(pixels[kept], shape), priors)
            priors = _with_lean(priors, lean_sigma(normal, own, known[0], priors, factor))
        d_own, d_shared = normal.step((own, shared), known, priors)
        own, shared = own + np.clip(d_own, -0.1, 0.1), shared + np.clip(d_shared, -0.05, 0.05)
        own_covariance, shared_covariance = (factor * part for part in normal.covariance(priors))
        if turn and _still(d_own, own_covariance) and _still(d_shared[None], shared_covariance[None]):
            break
    return Solution(
        own, shared, own_covariance, shared_covariance, met.ahead_mm, weights, law, met.surface, correlation
    )


def _still(steps: Array, covariances: Array) -> bool:
    """Whether steps (n, k) are small beside what is known (n, k, k), but for a stud that does not fit."""
    sigmas = np.sqrt(np.einsum("nkk->nk", covariances))
    return bool(np.mean(np.max(np.abs(steps) / sigmas, axis=1) < STILL_SIGMAS) > 0.9)


def _with_lean(priors: Priors, lean_rad: float) -> Priors:
    own = priors.own.copy()
    own[2:4] = lean_rad
    return replace(priors, own=own)


def _independent(
    met: Depths, weights: Array, sigmas: Array, stud: NDArray[np.intp], pixels: NDArray[np.intp] | None,
    shape: tuple[int, ...],
) -> tuple[Array, NDArray[np.intp], Array, Correlation]:  # fmt: skip
    """Rows freed from the noise that neighbouring pixels share, which points they belong to, and their weights."""
    kept = np.flatnonzero(weights > 0.1)
    rows = _rows(met, sigmas)
    grid = PixelGrid.of(pixels[kept], shape) if pixels is not None else None
    correlation = estimate(grid, rows[-1, kept]) if grid is not None else Correlation(0.0, 1.0)
    if grid is None or correlation.length_px == 0.0:
        return rows, np.arange(len(stud)), weights, correlation
    free = Whitener.of(grid, stud[kept], correlation).apply(rows[:, kept])
    # A point that does not go with its neighbours shows here only. Rows quieter than the model do not count for more:
    # the part of the noise that all neighbours share, which decides the place, is as large as before.
    spread = max(1.4826 * float(np.median(np.abs(free[-1]))), 0.1)
    ratio = np.minimum(np.abs(free[-1]) / (4.7 * spread), 1.0)
    return free, kept, np.square((1.0 - ratio**2) / max(spread, 1.0)), correlation


def _tiles(pixels: NDArray[np.intp], shape: tuple[int, ...], *, side: int = 6) -> NDArray[np.intp]:
    """Number (N,) of the square of `side` pixels in which each point lies."""
    rows, columns = np.divmod(pixels, shape[1])
    return np.asarray(rows // side * (shape[1] // side + 1) + columns // side)


def best_phase(rays: Rays, own: Array, shared: Array, form: Form, *, steps: int = 16) -> Array:
    """Phase (n,) in mm that fits each stud best among `steps` over one pitch, by a bounded cost."""
    phases = own[:, 4] + shared[PITCH] * np.arange(steps)[:, None] / steps
    costs = []
    for phase in phases:
        trial = own.copy()
        trial[:, 4] = phase
        costs.append(_cost(rays, trial, shared, form))
    return np.asarray(phases[np.argmin(costs, axis=0), np.arange(len(own))])


def best_lead_in(rays: Rays, own: Array, shared: Array, form: Form, depths_mm: Array) -> float:
    """How far below the tip the lead-in begins, among `depths_mm`: the same for all studs."""
    costs = []
    for depth in depths_mm:
        trial = own.copy()
        trial[:, 5] = form.tip_mm - depth
        costs.append(float(_cost(rays, trial, shared, form).sum()))
    return float(depths_mm[int(np.argmin(costs))])


def _cost(rays: Rays, own: Array, shared: Array, form: Form) -> Array:
    """Bounded misses across the surface, summed over the points of each stud (n,)."""
    met = depths(rays, own, shared, form)
    miss = np.minimum(np.abs(np.nan_to_num(met.ahead_mm, nan=9.0)) * met.cosine, 0.3)
    return np.bincount(rays.stud, np.where(on_thread(met, np.inf), miss, 0.3), len(own)).astype(np.float64)
