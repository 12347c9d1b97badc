"""Robust least squares of threaded studs on the depth along each ray: own parameters per stud, shared ones for all.

Some points bring the fit near; all points decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.shared_noise import SharedNoise, between
from cellctl.vision.stencil import Stencil
from cellctl.vision.thread_noise import NoiseLaw, learn, tukey
from cellctl.vision.thread_normal import Normal, lean_sigma
from cellctl.vision.thread_start import Start, near
from cellctl.vision.thread_surface import TIP, Array, Depths, Indices, Rays, depths

ROUNDS, STILL_SIGMAS, LEARNING = 8, 0.5, 3
"""Most steps; which are too small to matter; how many of the first teach how far studs lean, which a start on some of
the points exaggerates."""
FAR_SIGMAS = 15.0
"""Points farther from the stud than this are left out once the fit is near."""
LEARNERS = 8000
"""Points whose residuals say how noisy the scan is."""
PLACES = 10
"""Neighbours that are asked what they share with a point: more tell nothing beside a model error of as much."""


@dataclass(frozen=True, slots=True)
class Solution:
    """`own` (n, OWN), `shared` (SHARED,) with their type A covariances (n, OWN, OWN), (SHARED, SHARED).

    `residuals_mm` (N,) predicted minus measured depth; `weights` (N,) robust, 0 for what is no thread; `law` of the
    noise along the ray; `shared_noise` of neighbouring pixels that was found in the residuals; `surface` (N,) met.
    """

    own: Array
    shared: Array
    own_covariance: Array
    shared_covariance: Array
    residuals_mm: Array
    weights: Array
    law: NoiseLaw
    surface: NDArray[np.int8]
    shared_noise: SharedNoise | None


def solve(rays: Rays, start: Start, *, pixels: Indices | None = None, shape: tuple[int, ...] = ()) -> Solution:
    """Robust least squares to convergence; rows are freed from what neighbouring pixels share.

    `rays` sorted by stud. `pixels` (N,) are flat indices into an organised cloud of `shape`; without them the noise
    counts as white. How much studs lean is learnt from all of them.
    """
    own, shared, law = near(rays, start)
    whole = depths(rays, own, shared, start.form)
    law = learn(whole.take(slice(None, None, max(1, len(rays.stud) // LEARNERS))), law, shared)
    weights, sigmas = tukey(whole, law)
    used = np.flatnonzero((whole.surface < TIP) & (np.abs(whole.ahead_mm) < FAR_SIGMAS * sigmas))
    some, met, robust = rays.take(used), whole.take(used), (weights[used], sigmas[used])
    places = None
    if pixels is not None and len(shape) == 2:
        places = np.stack(np.divmod(pixels[used], shape[1]), axis=1)
    noise = _shared(met, *robust, places)
    known, priors, factor = (start.own, start.shared), start.priors, 1.0
    kept, stencil = _neighbours(robust[0], some.stud, places, noise)
    steps = np.zeros_like(own), np.zeros_like(shared)
    for turn in range(ROUNDS):
        if turn:
            # after the first step the surfaces count as flat; what it leaves is looked at again
            met = depths(some, own, shared, start.form) if turn > 1 else met.moved(steps, some.stud)
            robust = tukey(met, law)
        rows, square = _independent((met.rows / robust[1])[:, kept], robust[0][kept], stencil)
        normal = Normal.empty(len(own))
        normal.add(rows, square, some.stud[kept])
        if turn == 0 and places is not None:
            factor = normal.excess(rows, square, some.stud[kept], _tiles(places[kept]), priors)
        normal = normal.over(factor)
        if turn < LEARNING:
            priors = start.priors.leaning(lean_sigma(normal, own, known[0], start.priors))
        d_own, d_shared = normal.step((own, shared), known, priors)
        steps = np.clip(d_own, -0.1, 0.1), np.clip(d_shared, -0.05, 0.05)
        own, shared = own + steps[0], shared + steps[1]
        own_covariance, shared_covariance = normal.covariance(priors)
        if turn >= LEARNING - 1 and _still(d_own, own_covariance) and _still(d_shared[None], shared_covariance[None]):
            break
    weights[:] = 0.0
    weights[used], whole.ahead_mm[used], whole.surface[used] = robust[0], met.ahead_mm, met.surface
    return Solution(own, shared, own_covariance, shared_covariance, whole.ahead_mm, weights, law, whole.surface, noise)


def _still(steps: Array, covariances: Array) -> bool:
    """Whether steps (n, k) are small beside what is known (n, k, k), but for a stud that does not fit."""
    sigmas = np.sqrt(np.einsum("nkk->nk", covariances))
    return bool(np.mean(np.max(np.abs(steps) / sigmas, axis=1) < STILL_SIGMAS) > 0.9)


def _shared(met: Depths, weights: Array, sigmas: Array, places: Indices | None) -> SharedNoise | None:
    """What the residuals of neighbouring pixels share."""
    if places is None:
        return None
    kept = np.flatnonzero(weights > 0.1)
    return between(places[kept], (met.ahead_mm / sigmas)[kept])


def _neighbours(
    weights: Array, stud: Indices, places: Indices | None, noise: SharedNoise | None
) -> tuple[Indices | slice, Stencil | None]:
    """Points that count, and what each of them has in common with its neighbours; all of them where noise is white."""
    if noise is None or places is None:
        return slice(None), None
    kept = np.flatnonzero(weights > 0.1)
    return kept, Stencil.of(places[kept], stud[kept], noise.at, places=PLACES)


def _independent(rows: Array, weights: Array, stencil: Stencil | None) -> tuple[Array, Array]:
    """Rows freed from the noise that neighbouring pixels share, and their weights."""
    if stencil is None:
        return rows, weights
    free = stencil.apply(rows)
    # A point that does not go with its neighbours shows here only. Rows quieter than the model do not count for more:
    # the part of the noise that all neighbours share, which decides the place, is as large as before.
    spread = max(1.4826 * float(np.median(np.abs(free[-1]))), 0.1)
    ratio = np.minimum(np.abs(free[-1]) / (4.7 * spread), 1.0)
    return free, np.square((1.0 - ratio**2) / max(spread, 1.0))


def _tiles(places: Indices, *, side: int = 6) -> Indices:
    """Number (N,) of the square of `side` pixels in which each pixel (N, 2) lies."""
    row, column = (places // side).T
    return np.asarray(row * (column.max() + 1) + column)
