"""Robust least squares of threaded studs on the depth along each ray: own parameters per stud, shared ones for all.

Normal equations in arrow form (one small block a stud, a border for the shared parameters), solved by the Schur
complement, so that the cost is linear in points and studs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.correlation import Correlation, PixelGrid, Whitener, estimate
from cellctl.vision.thread_surface import LEAD_IN, OWN, SHARED, TIP, Array, Depths, Form, Rays, depths

MIN_SIGMA_MM = 1e-5
HELD_MM, HELD_ROUNDS = 1e-3, 5
"""The shared sizes stay at their start until the studs stand: freed at once, they may run off with the phases."""


@dataclass(frozen=True, slots=True)
class Priors:
    """One sigma of what is known beforehand; infinite where nothing is. `own` (OWN,) about zero slopes and about the
    start for the rest; `shared` (SHARED,) about the start."""

    own: Array
    shared: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """`own` (n, OWN), `shared` (SHARED,) with their type A covariances (n, OWN, OWN), (SHARED, SHARED).

    `residuals_mm` (N,) predicted minus measured depth; `weights` (N,) robust, 0 for what is no thread; `sigmas_mm` (N,)
    one sigma of each depth; `correlation` of neighbouring pixels that was found in them.
    """

    own: Array
    shared: Array
    own_covariance: Array
    shared_covariance: Array
    residuals_mm: Array
    weights: Array
    sigmas_mm: Array
    surface: NDArray[np.int8]
    correlation: Correlation


def solve(
    rays: Rays,
    own: Array,
    shared: Array,
    form: Form,
    priors: Priors,
    *,
    pixels: NDArray[np.intp] | None = None,
    shape: tuple[int, ...] = (),
    start_mm: float = 0.25,
    rounds: int = 14,
) -> Solution:
    """Robust least squares to convergence, then rounds that also free the rows from what neighbouring pixels share.

    The scale of the robust loss falls from `start_mm` to what the residuals show. `pixels` (N,) are flat indices into
    an organised cloud of `shape`; without them the noise counts as white.
    """
    known = (own.copy(), shared.copy())
    for turn in range(rounds):
        met = depths(rays, own, shared, form)
        weights, sigmas = weigh(met, start_mm * 0.5**turn if turn < 4 else 0.0, shared[2])
        blocks = _Blocks.of(_rows(met, sigmas) * np.sqrt(weights)[:, None], rays.stud, len(own))
        held = replace(priors, shared=np.minimum(priors.shared, HELD_MM)) if turn < HELD_ROUNDS else priors
        d_own, d_shared = blocks.step((own, shared), known, held)
        own, shared = own + np.clip(d_own, -0.3, 0.3), shared + np.clip(d_shared, -0.1, 0.1)
        if turn > HELD_ROUNDS + 1 and float(np.abs(d_own[:, [0, 1, 4]]).max()) < 1e-4:
            break
    correlation = Correlation(0.0, 1.0)
    for _ in range(3):
        met = depths(rays, own, shared, form)
        weights, sigmas = weigh(met, 0.0, shared[2])
        rows, kept, correlation = _independent(met, weights, sigmas, rays.stud, pixels, shape)
        blocks = _Blocks.of(rows, rays.stud[kept], len(own))
        d_own, d_shared = blocks.step((own, shared), known, priors)
        own, shared = own + np.clip(d_own, -0.1, 0.1), shared + np.clip(d_shared, -0.05, 0.05)
        if correlation.length_px == 0.0:
            break
    factor = 1.0
    if pixels is not None and len(shape) == 2:
        factor = blocks.excess(rows, rays.stud[kept], _tiles(pixels[kept], shape), priors)
    own_covariance, shared_covariance = (factor * part for part in blocks.covariance(priors))
    return Solution(
        own, shared, own_covariance, shared_covariance, met.ahead_mm, weights, sigmas, met.surface, correlation
    )


def _rows(met: Depths, sigmas: Array) -> Array:
    """Design and right-hand side (N, OWN + SHARED + 1) in units of one sigma."""
    return np.asarray(
        np.concatenate([met.own, met.shared, -np.nan_to_num(met.ahead_mm)[:, None]], axis=1) / sigmas[:, None]
    )


def _independent(
    met: Depths,
    weights: Array,
    sigmas: Array,
    stud: NDArray[np.intp],
    pixels: NDArray[np.intp] | None,
    shape: tuple[int, ...],
) -> tuple[Array, NDArray[np.intp], Correlation]:
    """Weighted rows freed from the noise that neighbouring pixels share, and which points they belong to."""
    rows = _rows(met, sigmas)
    kept = np.flatnonzero(weights > 0.1)
    grid = PixelGrid.of(pixels[kept], shape) if pixels is not None else None
    correlation = estimate(grid, rows[kept, -1]) if grid is not None else Correlation(0.0, 1.0)
    if grid is None or correlation.length_px == 0.0:
        return rows[kept] * np.sqrt(weights[kept])[:, None], kept, correlation
    free = Whitener.of(grid, stud[kept], correlation).apply(rows[kept])
    # A point that does not go with its neighbours shows here only. Rows quieter than the model do not count for more:
    # the part of the noise that all neighbours share, which decides the place, is as large as before.
    spread = max(1.4826 * float(np.median(np.abs(free[:, -1]))), 0.1)
    ratio = np.minimum(np.abs(free[:, -1]) / (4.7 * spread), 1.0)
    return free / max(spread, 1.0) * (1.0 - ratio**2)[:, None], kept, correlation


def _tiles(pixels: NDArray[np.intp], shape: tuple[int, ...], *, side: int = 6) -> NDArray[np.intp]:
    """Number (N,) of the square of `side` pixels in which each point lies."""
    rows, columns = np.divmod(pixels, shape[1])
    return np.asarray(rows // side * (shape[1] // side + 1) + columns // side)


def best_phase(rays: Rays, own: Array, shared: Array, form: Form, *, steps: int = 16, points: int = 4000) -> Array:
    """Phase (n,) in mm that fits each stud best among `steps` over one pitch, by a bounded cost on some points."""
    some = rays.take(np.arange(0, len(rays.stud), max(1, len(rays.stud) // points)))
    costs = []
    phases = own[:, 4] + shared[2] * np.arange(steps)[:, None] / steps
    for phase in phases:
        trial = own.copy()
        trial[:, 4] = phase
        met = depths(some, trial, shared, form)
        miss = np.minimum(np.abs(np.nan_to_num(met.ahead_mm, nan=9.0)) * met.cosine, 0.3)
        costs.append(np.bincount(some.stud, np.where(met.surface < TIP, miss, 0.0), len(own)))
    return np.asarray(phases[np.argmin(costs, axis=0), np.arange(len(own))])


def weigh(met: Depths, scale_mm: float, pitch_mm: float) -> tuple[Array, Array]:
    """Tukey weights (N,) and one sigma (N,) of each depth: noise that grows with one over the cosine of incidence.

    Its scale is the robust residual of thread and lead-in, or `scale_mm` where that is larger (while converging). The
    root below half a pitch, whose form no standard fixes, is left out.
    """
    on = (met.surface < TIP) & np.isfinite(met.ahead_mm)
    on &= (met.surface == LEAD_IN) | (met.below_mm < 0.5 * pitch_mm)
    sigmas = 1.0 / np.maximum(met.cosine, 0.1)
    ratio = np.where(on, np.abs(np.nan_to_num(met.ahead_mm)) / sigmas, np.inf)
    near = ratio[ratio < max(6.0 * scale_mm, 0.3)]
    spread = 1.4826 * float(np.median(near)) if len(near) > 5 else 0.03
    scale = max(spread, scale_mm, MIN_SIGMA_MM)
    weights = (1.0 - np.minimum(ratio / (4.7 * scale), 1.0) ** 2) ** 2
    return weights, sigmas * scale


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Normal matrix in arrow form: own (n, OWN, OWN), border (n, OWN, SHARED), corner; right-hand sides."""

    own: Array
    border: Array
    corner: Array
    own_side: Array
    shared_side: Array

    @classmethod
    def of(cls, rows: Array, stud: NDArray[np.intp], count: int) -> _Blocks:
        order = np.argsort(stud, kind="stable")
        starts = np.searchsorted(stud[order], np.arange(count + 1))
        size = OWN + SHARED + 1
        total = np.zeros((count, size, size))
        for i in range(count):
            mine = order[starts[i] : starts[i + 1]]
            total[i] = rows[mine].T @ rows[mine]
        return cls(
            total[:, :OWN, :OWN],
            total[:, :OWN, OWN:-1],
            total[:, OWN:-1, OWN:-1].sum(axis=0),
            total[:, :OWN, -1],
            total[:, OWN:-1, -1].sum(axis=0),
        )

    def _with(self, priors: Priors) -> tuple[Array, Array]:
        """Inverse own blocks (n, OWN, OWN) and inverse Schur complement (SHARED, SHARED), priors included."""
        inverse = np.linalg.inv(self.own + np.diag(priors.own**-2.0 + 1e-12))
        schur = self.corner + np.diag(priors.shared**-2.0 + 1e-9)
        schur = schur - np.einsum("nka,nkl,nlb->ab", self.border, inverse, self.border)
        return np.asarray(inverse), np.asarray(np.linalg.inv(schur))

    def step(self, now: tuple[Array, Array], known: tuple[Array, Array], priors: Priors) -> tuple[Array, Array]:
        """Gauss-Newton step of own and shared parameters; slopes are pulled to zero, the rest to what was known."""
        inverse, corner = self._with(priors)
        mean = known[0].copy()
        mean[:, 2:4] = 0.0
        side = self.own_side + (mean - now[0]) * priors.own**-2.0
        border = self.shared_side + (known[1] - now[1]) * priors.shared**-2.0
        d_shared = corner @ (border - np.einsum("nka,nkl,nl->a", self.border, inverse, side))
        d_own = np.einsum("nkl,nl->nk", inverse, side - self.border @ d_shared)
        return d_own, d_shared

    def covariance(self, priors: Priors) -> tuple[Array, Array]:
        inverse, corner = self._with(priors)
        lever = np.einsum("nkl,nla->nka", inverse, self.border)
        return inverse + np.einsum("nka,ab,nlb->nkl", lever, corner, lever), corner

    def excess(self, rows: Array, stud: NDArray[np.intp], tiles: NDArray[np.intp], priors: Priors) -> float:
        """How many times the variance of the studs' places exceeds the one of independent rows; at least 1.

        Tiles of pixels stand for independent groups, pooled over all studs (Liang, Zeger, Biometrika 73 (1986) 13),
        corrected for the parameters that the fit took from each stud's tiles.
        """
        inverse, _ = self._with(priors)
        influence = np.einsum("nkl,nl,n->nk", inverse[stud, :2], rows[:, :OWN], rows[:, -1])
        _, first, group = np.unique(stud * (int(tiles.max()) + 1) + tiles, return_index=True, return_inverse=True)
        groups = np.bincount(stud[first], minlength=len(inverse))
        sums = np.stack([np.bincount(group, influence[:, axis]) for axis in (0, 1)], axis=1)
        correction = groups[stud[first]] / np.maximum(groups[stud[first]] - 3.0, 1.0)
        enough = groups[stud[first]] > 4
        found = float(np.sum((sums**2 * correction[:, None])[enough]))
        data = inverse @ self.own @ inverse
        expected = float(np.sum(np.einsum("nkk->n", data[:, :2, :2])[groups > 4]))
        return max(found / expected, 1.0) if expected > 0 else 1.0
